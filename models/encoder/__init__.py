"""The unified encoder: one backbone, a depth head, a class head."""
