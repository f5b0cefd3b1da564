"""How the unified encoder comes to its weights, and how it sees."""
