"""A spatial network a file, named as in params.yaml."""
