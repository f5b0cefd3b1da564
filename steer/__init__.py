"""The command line: steer predict, measure, import, show, diff, doctor and export."""
