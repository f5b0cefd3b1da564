"""Write tables, figures, the page, and the files of DVC's metrics and plots. Only stage report imports this package."""
