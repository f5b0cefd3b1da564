"""What the stages compute with: plain functions on arrays."""
