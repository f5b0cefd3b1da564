"""What the car did from one frame to the next, measured from images and depth or from scans; no learning, no labels."""
