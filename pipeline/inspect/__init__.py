"""What an artefact holds and where it came from, and what a raw folder or a project lacks: for people, for no stage."""
