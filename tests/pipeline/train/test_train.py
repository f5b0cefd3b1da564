"""Windows and targets, batches and augmentation, scale and loss, checkpoints, predictions, runs."""

import copy
import pickle
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given
from hypothesis import strategies as st

from models.steering.core.motion import ANGLE, SPEED, VALID
from pipeline.base import checkpoint, loop
from pipeline.base.errors import InputError
from pipeline.graphs.graph_file import Arrays, open_graphs
from pipeline.train import fit, frames, loss, runs, trained, windows
from pipeline.train.loss import Scale
from pipeline.train.quantities.path import Target, end_points
from pipeline.train.settings import Train
from pipeline.train.targets import LabelledDrive, Timeline
from tests import artefacts, small_model
from tests.kitti_drive import write
from tests.small_model import entry

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
NAMES = [*DRIVES]
EDGES_M = [0.0, 5.0, 10.0, 20.0]
SETTINGS = yaml.safe_load(small_model.PARAMS.read_text())["train"]
# A spatial network that prepares frames.
POINTNET2: dict[str, Any] = {"spatial": "pointnet2", "semantics": 1.0, "centres": [12, 4]}


@pytest.fixture
def folder(tmp_path) -> Path:
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=12)
    return tmp_path


def read(folder: Path, **changes: object) -> list[LabelledDrive]:
    return small_model.read_drives(folder, DRIVES, **changes)


def batch_of(drives: Sequence[Timeline], *group: windows.Span, window: int = 8) -> Arrays:
    return {name: tensor.numpy() for name, tensor in windows.Reader(drives, window)[group].items()}


def test_spans_cover_each_window_of_consecutive_frames_once(folder):
    drives = read(folder)
    for seed in (None, *range(20)):
        rng = np.random.default_rng(seed) if seed is not None else None
        spans = windows.split_spans(drives, 8, 5, rng)
        ends = [(span.drive, row) for span in spans for row in range(span.start + 7, span.stop)]
        assert sorted(ends) == [(number, row) for number in range(2) for row in range(7, 23)]
        assert all(span.stop - span.start - 7 <= 5 for span in spans)


def test_a_missing_frame_ends_a_stretch(folder):
    drive = read(folder)[0]
    gaps = replace(drive, frame=np.array([3, 4, 5, 9, 10, 12]))
    assert gaps.stretches == [(0, 3), (3, 5), (5, 6)]
    assert replace(drive, frame=np.empty(0, int)).stretches == []


def test_batch_of_two_spans_equals_single_frames(folder):
    drives = read(folder)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    batch = batch_of(drives, *group)
    assert batch["windows"].shape == batch["dt_s"].shape == (4 + 2, 8)
    assert batch["windows"][3:5].tolist() == [[*range(3, 11)], [*range(11, 19)]]
    with open_graphs(drives[1].graphs) as first, open_graphs(drives[0].graphs) as second:
        joined = artefacts.collate((first, 3, 14), (second, 0, 9))
    assert all(np.array_equal(batch[name], joined[name]) for name in joined)
    target = np.concatenate([drives[1].target[10:14], drives[0].target[7:9]])
    assert (batch["target"] == target.astype("f4")).all()


def test_target_is_the_label_horizon_frames_ahead_by_frame_number(folder):
    steering = np.arange(25) / 100
    valid = np.arange(25) != 20
    frame = np.setdiff1d(np.arange(26), [10])  # frame 10 has neither label nor graph
    labels = folder / f"labels/{NAMES[0]}.h5"
    artefacts.write_labels(labels, steering, frame, valid)
    graphs = folder / f"graphs/semantic/{NAMES[0]}.h5"
    artefacts.write_graphs(graphs, np.zeros(22), frame[:22], 12)
    drive, _ = read(folder, horizon=5)
    label_of = dict(zip(frame[valid].tolist(), steering[valid], strict=True))
    expected = [label_of.get(number + 5, np.nan) for number in drive.frame.tolist()]
    assert drive.target[:, 0] == pytest.approx(expected, nan_ok=True)
    batch = batch_of([drive], windows.Span(0, 0, 10), window=4)  # windows end at frames 3 to 9
    expected = pytest.approx([0.08, 0.09, np.nan, 0.10, 0.11, 0.12, 0.13], nan_ok=True)
    assert batch["target"][:, 0] == expected
    artefacts.write_labels(labels, np.arange(20) / 100, np.arange(20))
    with pytest.raises(InputError, match="no label for frame 20"):
        read(folder)


def test_motion_and_base_of_a_batch(folder):
    """Motion is not measured in frames 0 and 5.

    The angle is held there. Hidden motion is that of frames without measurement, and has no base.
    """
    measured = ~np.isin(np.arange(23), [0, 5])
    for drive in read(folder):
        artefacts.write_steered(drive.motion_file, drive.target[:, 0], measured)
    drives = read(folder, motion="visual")
    held = drives[0].target[:, 0].copy()
    held[0] = 0
    held[5] = held[4]
    assert drives[0].base[:, 0] == pytest.approx(held, abs=1e-6)

    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    batch = batch_of(drives, *group)
    last_frames = batch["windows"][:, -1]
    assert (batch["base"][:, 0] == batch["motion"][last_frames, ANGLE]).all()
    assert batch["motion"][11 + 5].tolist() == [pytest.approx(held[4], abs=1e-6), 0, 0, 0]
    assert batch["motion"][11 + 6, [SPEED, VALID]].tolist() == [8, 1]

    without_base = batch_of(read(folder, motion="visual", base="none"), *group)
    assert (without_base["motion"] == batch["motion"]).all()
    assert not without_base["base"].any()
    entry = small_model.entry(motion="visual")
    problem = r"the model needs measured motion\. Pass the drive's file"
    with open_graphs(drives[0].graphs) as graphs, pytest.raises(InputError, match=problem):
        Timeline.read(graphs, None, drives[0].quantity, entry)
    plain = batch_of(read(folder), *group)
    assert "motion" not in plain
    assert not plain["base"].any()

    hidden = batch_of(drives, group[0], replace(group[1], hidden=True))
    for name, first in (("motion", 11), ("base", 4)):  # rows of the first span
        assert (hidden[name][:first] == batch[name][:first]).all()
        assert not hidden[name][first:].any()
    assert (hidden["target"] == batch["target"]).all()


@pytest.mark.parametrize("in_memory", [False, True])
@pytest.mark.parametrize("kind", [*artefacts.VARIANTS, "image"])
def test_batches_are_the_same_wherever_frames_are_kept(tmp_path, device, kind, in_memory):
    """A drive that is scaled stays as it is for the next batch."""
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=40, kind=kind)
    drives = read(tmp_path)
    if kind == "points":  # frames are prepared, too
        drives = read(tmp_path, **POINTNET2)
    groups = []
    for start in (0, 2, 4):
        groups.append([windows.Span(0, start, start + 9, 1.1)])
        row = start + 1
        groups.append([windows.Span(1, row, row + 9, 1.1), windows.Span(1, 2 * row, 2 * row + 9)])
    files = frames.Files((drive.graphs for drive in drives), in_memory)
    files.load_frames(torch.device(device))
    assert all(bool(files[drive.graphs].kept) == in_memory for drive in drives)
    reader = windows.Reader(drives, 4, files)
    for _ in range(2):
        batches = reader.read_batches(groups, torch.device(device))
        for group, batch in zip(groups, batches, strict=True):
            expected = batch_of(drives, *group, window=4)
            assert batch.keys() == expected.keys()
            for name, tensor in batch.items():
                np.testing.assert_array_equal(tensor.cpu().numpy(), expected[name], strict=True)
            assert ("prepared" in batch) == (kind == "points")
    assert not pickle.loads(pickle.dumps(files))[drives[0].graphs].kept


@pytest.mark.parametrize(("free", "fits"), [(1e6, True), (1e3, False)])
def test_frames_are_kept_on_a_gpu_where_half_of_its_memory_holds_them(
    folder, monkeypatch, free, fits
):
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda: (free, 1e7))
    assert frames.Files(drive.graphs for drive in read(folder))._fit_gpu() == fits


@pytest.mark.parametrize(
    ("ahead", "motion", "spatial", "hides"),
    [
        (5, "visual", "gnn", True),
        (0, "visual", "gnn", False),
        (5, "none", "gnn", False),
        (5, "visual", "blind", False),
    ],
)
def test_motion_is_hidden_from_half_of_the_spans_beside_a_scene_ahead(
    folder, ahead, motion, spatial, hides
):
    model = entry(spatial=spatial, temporal="lstm", window=4, motion=motion, horizon=ahead)
    settings = Train(**SETTINGS | {"span_windows": 1})
    fitting = fit.Fit(model.build("graph"), model, settings, 0, read(folder, horizon=ahead), [])
    share = np.mean([span.hidden for group in fitting._plan_epoch(epoch=1) for span in group])
    assert share == (pytest.approx(0.5, abs=0.2) if hides else 0)


@pytest.mark.parametrize("spatial", ["cnn", "blind"])
def test_a_network_that_reads_no_classes_ignores_their_weight(spatial):
    assert entry(spatial=spatial, semantics=1.0) == entry(spatial=spatial)


@pytest.mark.parametrize("kind", [*artefacts.VARIANTS, "image"])
@pytest.mark.parametrize("predicted", ["angle", "path"])
def test_a_world_twice_as_large_has_bends_of_twice_the_radius(tmp_path, predicted, kind):
    dataset = {"frames": 40, "points": 40, "kind": kind, "ahead_m": EDGES_M, "motion": True}
    artefacts.write_dataset(tmp_path, DRIVES, **dataset)
    network = POINTNET2 if kind == "points" else {}
    drives = read(tmp_path, motion="visual", predict=predicted, **network)
    second = windows.Span(1, 1, 10)  # has two windows, the first span three
    batch = batch_of(drives, windows.Span(0, 0, 10), second)
    scaled = batch_of(drives, windows.Span(0, 0, 10, factor=2.0), second)
    assert scaled.keys() == batch.keys()
    if "image" in batch:  # a larger world gives the same image
        assert all((scaled[key] == batch[key]).all() for key in batch)
        return
    factor = np.where(np.arange(len(batch["xyz"])) < batch["ptr"][10], 2, 1)[:, None]
    assert (scaled["xyz"] == batch["xyz"] * factor).all()
    if kind == "columns":
        assert (scaled["offset_m"] == batch["offset_m"] * factor).all()
        assert (scaled["colour"] == batch["colour"]).all()
    if kind == "points":
        assert (scaled["prepared"] == batch["prepared"]).all()

    angle, yaw_rate, speed, _ = scaled["motion"].T.astype(np.float64)
    assert (speed == batch["motion"][:, SPEED] * np.repeat([2, 1], [10, 9])).all()
    turn = artefacts.WHEELBASE_M * yaw_rate
    assert speed * np.tan(angle) == pytest.approx(turn, rel=1e-5, abs=1e-6)
    for name in ("base", "target"):
        large = scaled[name].reshape(5, -1)[:, 0]
        small = batch[name].reshape(5, -1)[:, 0]
        if predicted == "angle":
            large = np.tan(large)
            small = np.tan(small)
        assert large == pytest.approx(small / [2, 2, 2, 1, 1], rel=1e-5)


@pytest.mark.parametrize("edges_m", [[0, 5, 10, 20, 30], [4, 8], [2, 2.5, 40]])
def test_the_ends_of_a_path_are_those_of_fine_integration(edges_m):
    """A path of arcs, a straight among them, which begins at the first edge."""
    curvature = np.array([0.15, 0.0, -0.3, 0.02])[: len(edges_m) - 1]
    step_m = 1e-3
    arc_m = np.arange(edges_m[0], edges_m[-1] - step_m / 2, step_m) + step_m / 2
    steps = curvature[np.searchsorted(edges_m, arc_m) - 1] * step_m
    heading_rad = np.cumsum(steps) - steps / 2
    course = np.cumsum(np.stack([np.cos(heading_rad), np.sin(heading_rad)], 1) * step_m, axis=0)
    far = np.round((np.array(edges_m[1:]) - edges_m[0]) / step_m).astype(int) - 1
    points = end_points(np.stack([curvature, -curvature]), edges_m)
    np.testing.assert_allclose(points[0], course[far], atol=1e-5)
    np.testing.assert_allclose(points[1], course[far] * [1, -1], atol=1e-5)


@pytest.mark.parametrize(
    ("edges_m", "lead"),
    [([0, 5, 10, 20, 30], "at 20 m"), ([0, 5, 10], "at 5 m"), ([4, 8], "at 8 m")],
)
def test_the_end_before_the_last_leads(edges_m, lead):
    quantity = Target({"wheelbase_m": 2.7, "min_speed_mps": 1.0, "ahead_m": edges_m})
    assert quantity.lead == lead
    assert quantity.ends == [f"at {far} m" for far in edges_m[1:]]


@given(
    st.floats(0.5, 2.0), st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3), st.integers(0, 3)
)
def test_the_path_in_a_larger_world_has_the_mean_curvature_of_its_stretched_course(
    factor, values, unknown
):
    curvature = np.array(values)
    path = np.where(np.arange(3) == unknown, np.nan, curvature)
    quantity = Target({"wheelbase_m": 2.7, "min_speed_mps": 1.0, "ahead_m": EDGES_M})
    (scaled,) = quantity.rescale(path[None], factor)

    # Curvature along the course, at distances in the scaled world in metres.
    distance = (np.arange(20_000) + 0.5) / 1000
    row = np.clip(np.searchsorted(EDGES_M, distance / factor) - 1, 0, 2)
    course = curvature[row] / factor

    # Nothing is known in a range, unless there is no unknown one, and beyond the last.
    unknown_m = [(EDGES_M[-1], np.inf)]
    if unknown < 3:
        unknown_m.append((EDGES_M[unknown], EDGES_M[unknown + 1]))
    for value, (near, far) in zip(scaled, pairwise(EDGES_M), strict=True):
        overlap_m = max(min(far / factor, b) - max(near / factor, a) for a, b in unknown_m)
        if not 0 < overlap_m < 0.01:  # where rounding does not decide
            assert np.isfinite(value) == (overlap_m <= 0)
        if np.isfinite(value):
            expected = course[(distance > near) & (distance < far)].mean()
            assert value == pytest.approx(expected, abs=3e-4)


@pytest.mark.parametrize("threads", [1, 3])
def test_items_come_in_order_and_a_bounded_number_ahead_of_their_use(threads):
    begun = list[int]()

    def begin(number: int) -> int:
        if number == 40:
            raise ValueError("frame 40 is damaged")
        begun.append(number)
        return number

    def slow_first(number: int) -> int:
        if number == 0:
            time.sleep(0.02)
        return number

    for stop in (1, 30):
        assert list(loop.prefetch(slow_first, range(stop), threads, ahead=4)) == list(range(stop))
    items = loop.prefetch(slow_first, map(begin, range(41)), threads, ahead=4)
    for number in range(5):
        assert next(items) == number
        assert number + 1 < len(begun) <= number + 1 + 4
    with pytest.raises(ValueError, match="frame 40 is damaged"):
        list(items)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


@pytest.mark.parametrize("reading", [{"horizon": 5}, {"predict": "path"}])
def test_scale_is_the_regression_and_spread_of_the_residual(tmp_path, monkeypatch, reading):
    """The gain is the regression's for a path; an angle's is 1. Both are odd."""
    artefacts.write_dataset(tmp_path, DRIVES, frames=40, points=12, ahead_m=[0, 5, 10])
    for name, factor in zip(NAMES, (0.2, -0.3), strict=True):
        steering_rad = factor * np.sin(np.arange(40) / 5)
        artefacts.write_steered(tmp_path / f"motion/{name}.h5", steering_rad)
    drives = read(tmp_path, motion="visual", **reading)
    scale = Scale.from_drives(drives)
    monkeypatch.setattr(type(drives[0].quantity), "is_odd", False)
    uncentred = Scale.from_drives(drives)
    truth = np.concatenate([drive.target for drive in drives])
    base = np.concatenate([drive.base for drive in drives])
    for number in range(len(scale.names)):
        known = np.isfinite(truth[:, number])
        assert 0 < known.sum() < len(truth)
        x = base[known, number]
        y = truth[known, number]
        (best,), *_ = np.linalg.lstsq(x[:, None], y, rcond=None)
        assert scale.gain[number] == (pytest.approx(best) if "predict" in reading else 1)
        residual = y - scale.gain[number] * x
        assert scale.offset[number] == 0
        assert uncentred.offset[number] == pytest.approx(residual.mean())
        assert scale.std[number] == uncentred.std[number] == pytest.approx(residual.std())
        assert scale.mean[number] == pytest.approx(y.mean())


def test_targets_of_a_step_are_standardised_and_weighted_and_decode_undoes_it():
    scale = Scale(["a"], np.array([0.5]), np.array([0.1]), np.array([0.2]), np.zeros(1))
    target = torch.tensor([[0.2], [-0.3], [torch.nan]]).double()
    base = torch.tensor([[0.1], [0.0], [0.0]]).double()
    gain = torch.from_numpy(scale.gain)
    offset = torch.from_numpy(scale.offset)
    std = torch.from_numpy(scale.std)
    batch = {"target": target, "base": base}
    residual, weight = loss.batch_targets(batch, gain, offset, std, alpha=2.0)
    assert residual[:, 0].tolist() == pytest.approx([0.25, -2.0, -0.5])
    assert weight[:, 0].tolist() == pytest.approx([np.exp(0.4), np.exp(0.6), 0.0])
    decoded = Scale.parse(scale.content).decode(residual.numpy(), base.numpy())
    np.testing.assert_allclose(decoded[:2], target[:2])


@pytest.mark.parametrize("robust", [False, True])
def test_loss_is_the_weighted_sum_of_squares_or_of_hubers_function(robust):
    error = torch.tensor([[0.5, -1.0], [9.0, 7.0]])
    weight = torch.tensor([[2.0, 1.0], [1.0, 0.0]])
    target = torch.full((2, 2), 3.0)
    expected = 0.25 + 0.5 + 8.5 if robust else 0.5 + 1 + 81
    assert loss.weighted_loss(target + error, target, weight, robust).item() == expected
    with pytest.raises(ValueError, match=r"outputs have the shape \[\d+, 1\], the targets"):
        loss.weighted_loss(target[:, :1], target, weight, robust)


WINDOW = 4
# Networks that an earlier revision had.
POLAR = {"spatial": "polar", "temporal": "ncp"}


def write_model(folder: Path, change: dict[str, Any] | None = None) -> Path:
    """Write a best.pt with random weights."""
    torch.manual_seed(0)
    model = entry(features=8, window=WINDOW)
    content = {
        "kind": trained.KIND,
        "name": "net",
        "seeds": [0],
        "scale": Scale(
            ["steering_rad"], np.ones(1), np.zeros(1), np.array([0.12]), np.zeros(1)
        ).content,
        "contents": {"kind": "graph"},
        "entry": model.model_dump(mode="json"),
        "settings": artefacts.LABELS,
        "drives": ["a"],
        "fps": 10.0,
        "net": model.build("graph").state_dict(),
    }
    checkpoint.write(folder / "best.pt", content | (change or {}))
    return folder


def test_shared_frames_equal_naive_windows_and_gaps_are_nan(tmp_path):
    numbers = np.array([*range(10, 22), *range(25, 36), 40])  # stretches of 12, 11 and 1 frames
    artefacts.write_graphs(tmp_path / "drive.h5", 0.1 * np.sin(numbers / 5), numbers, 40)
    model = trained.load_model(str(write_model(tmp_path / "net")), "cpu")
    with open_graphs(tmp_path / "drive.h5") as graphs:
        steering_rad = model.predict(graphs)[:, 0]
        timeline = Timeline.read(graphs, None, model.quantity, model.entry)
        for row, number in enumerate(numbers):
            before = numbers[max(0, row - WINDOW + 1) : row + 1]
            if len(before) < WINDOW or number - before[0] >= WINDOW:
                assert np.isnan(steering_rad[row])
                continue
            span = windows.Span(0, row - WINDOW + 1, row + 1)
            batch = batch_of([timeline], span, window=WINDOW)
            with torch.inference_mode():
                output = model.net(*model.net.inputs(batch)).item()
            assert steering_rad[row] == pytest.approx(0.12 * output, abs=1e-6)
        assert np.isfinite(steering_rad).sum() == (12 - 3) + (11 - 3)

        # NaN is only where no window ends. A network that returns it is refused.
        with torch.no_grad():
            model.net.temporal.output_shift.fill_(torch.inf)
        problem = r"model net: .*drive\.h5: the network returns NaN or infinity for 17 of 17 frames"
        with pytest.raises(InputError, match=problem):
            model.predict(graphs)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("nett", {}, r"best\.pt is missing.*train/net"),
        ("net", {"kind": "encoder"}, "expected a checkpoint of .* steering net.*Train it again"),
        ("net", {"entry": POLAR}, "there is no .*polar.py .*revision 12c983c8"),
        ("net", {"scale": None}, "Train it again"),
        (
            "net",
            {"contents": {"kind": "sets", "levels": 2}},
            r"best\.pt: levels = 2 is not supported any more. Train .* use it at revision 12c983c8",
        ),
        ("net", {"net": {"weight": torch.zeros(1)}}, "Train it again"),
        ("net", {"trap": artefacts.Trap(Path("sprung"))}, "more than tensors"),
        ("cut", {}, "file is damaged"),
    ],
)
def test_a_wrong_checkpoint_is_one_line_and_runs_no_code(tmp_path, name, change, message):
    written = write_model(tmp_path / "train/net", change)
    folder = written.with_name(name)
    if name == "cut":
        write(folder / "best.pt", (written / "best.pt").read_bytes()[:-200])
    with pytest.raises(InputError, match=message) as raised:
        trained.load_model(folder, "cpu")
    assert "\n" not in str(raised.value)
    assert not Path("sprung").exists()


def test_weights_that_are_not_finite_are_refused():
    net = torch.nn.Linear(3, 2)
    state = net.state_dict() | {"bias": torch.full((2,), torch.nan)}
    with pytest.raises(InputError, match="bias has values that are not finite"):
        checkpoint.load_state(net, state, Path("x.pt"))


def test_a_split_without_training_drives_is_refused():
    with pytest.raises(InputError, match="no training drives"):
        runs.check_splits({"x": "test"})


def test_three_steps_are_those_of_adamw_with_warm_up_and_an_average_of_the_weights(folder):
    """The optimiser is written out. Vectors have no weight decay."""
    model = entry(spatial="gnn", temporal="lstm", features=8, layers=[8])
    change = {"epochs": 2, "learning_rate": 0.002, "weight_decay": 9.0, "average": 0.9}
    change |= {"span_windows": 6, "batch_spans": 3, "clip_norm": 0.5}
    settings = Train(**SETTINGS | change)
    torch.manual_seed(0)
    net = model.build("graph").train()
    # The mean of features is subtracted, so the gradient of this offset would be of rounding alone.
    net.spatial.read_out.bias.requires_grad_(False)
    fitting = fit.Fit(copy.deepcopy(net), model, settings, 0, read(folder), [])
    net.scale.momentum = fitting.net.scale.momentum
    trained_weights = [weights for weights in net.parameters() if weights.requires_grad]
    reader = windows.Reader(fitting.train, model.window)
    fitting._train_epoch(reader, epoch=1)

    groups = fitting._plan_epoch(epoch=1)
    assert len(groups) == 3
    average = [torch.zeros_like(weights) for weights in trained_weights]
    mean = [torch.zeros_like(weights) for weights in trained_weights]
    square = [torch.zeros_like(weights) for weights in trained_weights]
    for step, batch in enumerate(reader.read_batches(groups, net.device)):
        output = net(*net.inputs(batch))
        target = batch["target"] / fitting.scale.std.item()
        (output - target).square().mean().backward()

        # The rate rises over 5 % of the training, then falls as half a cosine.
        progress = step / 3 / 2
        factor = 0.05 if step == 0 else (1 + np.cos(np.pi * (progress - 0.05) / 0.95)) / 2
        rate = 0.002 * factor
        norm = (
            torch.stack([weights.grad.square().sum() for weights in trained_weights]).sum().sqrt()
        )
        clip = min(1.0, 0.5 / norm.item())
        kept = 0.9 if step else 0.0
        for number, weights in enumerate(trained_weights):
            gradient = weights.grad * clip
            mean[number] = 0.9 * mean[number] + 0.1 * gradient
            square[number] = 0.999 * square[number] + 0.001 * gradient**2
            first = mean[number] / (1 - 0.9 ** (step + 1))
            second = square[number] / (1 - 0.999 ** (step + 1))
            decay = 9.0 * weights.data if weights.ndim > 1 else 0.0
            weights.data -= rate * (first / (second.sqrt() + 1e-8) + decay)
            average[number] = kept * average[number] + (1 - kept) * weights.data
            weights.grad = None

    for fitted, expected in (
        (fitting.net, trained_weights),
        (fitting.average, average),
    ):
        values = [weights for weights in fitted.parameters() if weights.requires_grad]
        torch.testing.assert_close(values, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("nmse", "selected"),
    [
        ((0.9, 0.3, 0.8, 0.5, 0.4, 0.41, 0.7), 6),  # the least mean of three, not the lucky second
        ((0.9, 0.8, np.nan), 2),
        ((np.nan, np.nan), 2),  # without validation the last
        ((), 0),
    ],
)
def test_the_kept_epoch(nmse, selected):
    assert fit.selected_epoch([{"val_nmse": error} for error in nmse]) == selected
