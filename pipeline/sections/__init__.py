"""The sections of ``params.yaml``, a file each: editing one stage's knobs runs no other stage again."""
