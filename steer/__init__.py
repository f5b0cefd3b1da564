"""Command line for users of a trained model: steer predict, import, show, diff, doctor, export."""
