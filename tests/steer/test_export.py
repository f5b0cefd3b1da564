"""Files of points for other programs, as Open3D reads them."""

import errno
import shutil
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from steer.artefact import open_drive
from steer.export import export_points
from tests import artefacts, street
from tests.pipeline.base.test_base import files_up_to

DRIVE = "2011_09_26_drive_0001"
FRAME = 2
# Kind of files → its further columns → names of their components.
FURTHER: dict[str, dict[str, list[str]]] = {
    "clouds/pseudo": {},
    "clouds/lidar": {"intensity": ["intensity"]},
    "graphs/semantic": {
        "offset_m": ["offset_m_0", "offset_m_1"],
        "colour": ["colour_0", "colour_1", "colour_2"],
    },
}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """Return a folder with the files of a drive in which each frame has an image and a scan."""
    data = tmp_path_factory.mktemp("data")
    ingest = data / f"ingest/{DRIVE}.h5"
    street.write_drive(ingest.parent, DRIVE, 4, lidar=True)
    street.write_perception(data / "perception", ingest.parent, DRIVE)
    settings = Clouds(max_points=2048, max_depth_m=80.0, seed=0, columns=["intensity"])
    for kind in ("pseudo", "lidar"):
        path = data / f"clouds/{kind}/{DRIVE}.h5"
        perception = data / f"perception/{DRIVE}.h5"
        clouds_drive(path, kind, ingest, perception, settings.of_source(kind))
    graphs = data / f"graphs/semantic/{DRIVE}.h5"
    artefacts.write_graphs(graphs, np.zeros(4), np.arange(4), 80, kind="columns")
    return data


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
@pytest.mark.parametrize("kind", FURTHER)
def test_points_keep_their_values_and_get_the_colour_of_their_pixel(data, tmp_path, kind, suffix):
    out = tmp_path / f"cloud.{suffix}"
    export_points(data / kind / f"{DRIVE}.h5", FRAME, out)
    read = o3d.t.io.read_point_cloud(str(out)).point
    exported = {name: values.numpy() for name, values in read.items()}
    xyz = exported.pop("positions")
    rgb = exported.pop("colors")

    # Coordinates, classes and each component of the further columns are those of the file.
    with open_drive(data / kind / f"{DRIVE}.h5") as file:
        np.testing.assert_array_equal(xyz, file.rows_of("xyz", FRAME))
        expected = {"class": file.rows_of("cls", FRAME)[:, None]}
        for name, components in FURTHER[kind].items():
            values = file.rows_of(name, FRAME)
            expected |= {key: values[:, [column]] for column, key in enumerate(components)}
        assert file.signs.keys() == FURTHER[kind].keys()
        np.testing.assert_equal(exported, expected)

    # A point that the camera sees has the colour of its pixel, and others are black.
    image, *_ = street.scene(FRAME)
    u, v = np.rint((xyz @ street.K.T)[:, :2].T / xyz[:, 2]).astype(int)
    height, width = street.SIZE
    in_image = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    has_colour = rgb.any(axis=1)
    assert has_colour[in_image].mean() > 0.6
    assert has_colour.all() or kind != "clouds/pseudo"
    assert not has_colour[~in_image].any()
    np.testing.assert_array_equal(rgb[has_colour], image[v[has_colour], u[has_colour]])


def test_without_an_image_points_have_no_colour(data, tmp_path):
    cloud = tmp_path / f"clouds/lidar/{DRIVE}.h5"
    cloud.parent.mkdir(parents=True)
    shutil.copy(data / f"clouds/lidar/{DRIVE}.h5", cloud)
    out = tmp_path / "cloud.pcd"
    about = export_points(cloud, FRAME, out)
    assert about.endswith("no colour, as there is no image in data/ingest")
    assert {*o3d.t.io.read_point_cloud(str(out)).point} == {"positions", "class", "intensity"}


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
def test_a_full_disk_leaves_no_file(data, tmp_path, suffix):
    """Open3D reports no error for a PLY file."""
    out = tmp_path / f"cloud.{suffix}"
    with pytest.raises(OSError, match=out.name) as error, files_up_to(10_000):
        export_points(data / f"clouds/pseudo/{DRIVE}.h5", FRAME, out)
    assert error.value.errno == errno.ENOSPC
    assert not list(tmp_path.iterdir())
