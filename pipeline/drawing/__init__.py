"""Pictures of graphs, clouds, perception and steering, shared by the report, live results and inspection."""
