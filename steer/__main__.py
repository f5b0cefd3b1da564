"""python -m steer, where the command steer is not on the path."""

from steer.app import app

app(prog_name="steer")
