"""What all steering networks share."""
