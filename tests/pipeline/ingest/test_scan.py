"""What a scan of all images says to the user."""

import re

import numpy as np

from tests.pipeline.ingest.videos import images_of_a_street, open_recording, write_streams


def test_black_bars_and_interlaced_fields_are_said(tmp_path):
    images = [np.pad(image, [(8, 6), (0, 0), (0, 0)]) for image in images_of_a_street()[:5]]
    stream = {"images": images, "codec": "mpeg4", "options": {"flags": "+ilme+ildct"}}
    fields, bars = open_recording(write_streams(tmp_path / "a.mp4", stream)).notes
    assert fields.endswith("ffmpeg -i a.mp4 -vf bwdif=send_frame progressive.mp4")
    assert re.search(r"crop=320:9\d:0:8 cropped.mp4, cx - 0 and cy - 8", bars)
