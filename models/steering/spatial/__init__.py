"""Spatial networks, one per file; `spatial: NAME` in params.yaml is NAME.py. See core/steering_net.py."""
