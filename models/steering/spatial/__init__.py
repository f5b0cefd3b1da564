"""A spatial network a file, named as in params.yaml: see models/steering/core/steering_net.py."""
