"""Recurrent networks, one per file; `temporal: NAME` in params.yaml is NAME.py. See core/steering_net.py."""
