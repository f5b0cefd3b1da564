"""Run the command with `python -m steer`, without `steer` on the path."""

from steer.app import app

app(prog_name="steer")
