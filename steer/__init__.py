"""The command line of people who have a model: steer predict, import, show, doctor, export."""
