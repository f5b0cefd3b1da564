"""The networks: nn.Modules and the knobs that they take; no files, no command line."""
