"""The command line: steer predict, measure, import and show."""
