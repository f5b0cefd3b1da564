"""The page that people open: data/report/index.html, one file with all that it needs."""
