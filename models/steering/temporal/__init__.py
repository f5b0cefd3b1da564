"""A temporal network a file, named as in params.yaml."""
