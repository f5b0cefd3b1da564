"""A cell of temporal: ncp a file, named as in params.yaml."""
