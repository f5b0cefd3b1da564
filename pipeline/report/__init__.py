"""What judges and shows: an edit here trains nothing."""
