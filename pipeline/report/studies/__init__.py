"""What one setting is worth: a figure and a table of each study, and the paper's claims."""
