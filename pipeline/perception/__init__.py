"""What depth is worth: its scale, its scores, flat ground beside it; and what measured motion is."""
