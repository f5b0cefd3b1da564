"""The networks: nn.Modules and their options; no files, no command line."""
