"""Write tables, figures and the page, the files of DVC's metrics and plots, and pictures of single frames."""
