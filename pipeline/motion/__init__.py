"""Visual odometry: the car's motion since the previous frame, without learning and without labels."""
