"""Train steering networks on graph files, and predict with them."""
