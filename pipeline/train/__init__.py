"""From graph files to a trained steering network, and its predictions."""
