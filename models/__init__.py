"""The networks: nn.Module only, no files, no command line."""
