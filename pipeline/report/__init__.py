"""The report: tables, figures, and the page. No other stage depends on this package, so an edit trains nothing."""
