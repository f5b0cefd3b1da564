"""What it costs: ``python -m benchmarks.<name>`` measures on this machine and prints a table."""
