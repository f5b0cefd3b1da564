"""Measure this project beside alternatives.

``python -m benchmarks.alternatives networks`` compares its speed with PyTorch Geometric and ncps.
They run in turn with this project, on the same arrays and on a single thread.

``python -m benchmarks.alternatives udacity MOTION CSV LEADERBOARD`` compares its steering angles in
the test drive Ch2_001 of Udacity's Challenge 2 with the predictions of three leading teams.
"""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import torch
from ncps import torch as ncps_torch
from ncps.wirings import NCP
from torch import Tensor, nn
from torch_geometric.nn.conv.gcn_conv import gcn_norm

from pipeline.jobs import console
from pipeline.jobs.origin import describe_origin

from models.steering.core.batch import GraphBatch, from_arrays
from models.steering.core.cell.ltc import LTC
from models.steering.core.features import mean_max_pool, node_features
from models.steering.core.wiring import ncp
from models.steering.spatial import gnn, pyg
from pipeline.base import store
from pipeline.check import street_frames
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.settings import Variant
from pipeline.train.entry import Entry
from pipeline.train.frames import join_frames, number_rows

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"

# Number of times that both sides of a row are measured; their medians are printed.
ROUNDS = 5

# Variant of the random street's graphs. It has the sizes of the paper's Table 1.
VARIANT = Variant(source="clouds/pseudo", points=43_000, k=6, keep_inter_class=0.2)

# Number of frames of the random street, which are a span of 24 windows.
FRAMES = 31

# Number of frames in a window.
WINDOW = 8

# Number of frames in a batch of the graph convolutions.
GCN_FRAMES = 4

# Number of features of a frame, which the recurrent network gets.
FEATURES = 32

# The network of this project that is measured, sa-gnn-ncp of the demo.
ENTRY = Entry.model_validate(
    {
        "input": "semantic",
        "spatial": "gnn",
        "temporal": "ncp",
        "window": WINDOW,
        "features": FEATURES,
        "semantics": 1.0,
    }
)

# Seconds at the start of Udacity's drive on which gain, offset and lag are fitted. The angles after
# these seconds are compared.
FITTED_S = 30.0

# Lags in seconds by which measured motion may follow the steering wheel; the best of them is taken.
LAGS_S = np.arange(-0.2, 0.41, 0.02)

# Function that does the work of a measurement, and returns the number of items that it processed.
Work = Callable[[], int]


def networks() -> None:
    """Print the times of this project and of the alternatives as a Markdown table."""
    torch.set_num_threads(1)
    print(
        f"{describe_origin()['machine']}\n\n| ms | ours | alternative | ratio |\n|---|--:|--:|--:|"
    )
    with TemporaryDirectory() as folder:
        street = write_street(Path(folder))
        compare_gcn(street)
        compare_windows(street)
        compare_ltc()


def compare_gcn(street: Path) -> None:
    """Compare graph convolutions with GCNConv. Both normalise edges once for all layers."""
    batch = read_graphs(street, GCN_FRAMES)
    net = gnn.GCN(FEATURES, gnn.Options(semantics=1.0)).to(DEVICE)
    pyg_net = pyg_gcn(normalize=False)

    def ours() -> int:
        backward(net(batch))
        return GCN_FRAMES

    def alternative() -> int:
        backward(normalised_once(pyg_net, batch))
        return GCN_FRAMES

    print_row("a frame, three graph convolutions, both ways; PyG's GCNConv", ours, alternative)


def compare_windows(street: Path) -> None:
    """Compare a training step on a span with steps on single windows. Both include reading.

    The alternative uses PyTorch Geometric and ncps. It reads and encodes the frames of each window
    again, although windows share frames.
    """
    net = ENTRY.build("graph").to(DEVICE)
    optimiser = torch.optim.AdamW(net.parameters())

    def ours() -> int:
        windows, dt_s = window_rows()
        train_step(optimiser, net(read_graphs(street, FRAMES), windows, dt_s))
        return len(windows)

    pyg_net = pyg_gcn(normalize=True)
    ltc = ncps_ltc()
    pyg_optimiser = torch.optim.AdamW([*pyg_net.parameters(), *ltc.parameters()])

    def alternative() -> int:
        features = pyg_net(read_graphs(street, WINDOW))
        outputs, _ = ltc(features.tanh()[None])
        train_step(pyg_optimiser, outputs[:, -1])
        return 1

    print_row(f"a window of {WINDOW} frames, read and trained; PyG and ncps", ours, alternative)


def compare_ltc() -> None:
    """Compare LTC networks on windows that share frames; forward and backward passes."""
    x = torch.randn(FRAMES, FEATURES, device=DEVICE)
    windows, dt_s = window_rows()
    ltc = LTC(ncp(FEATURES)).to(DEVICE)
    peer = ncps_ltc()

    def ours() -> int:
        inputs = ltc.project_inputs(x)
        backward(ltc(inputs[windows], dt_s)[:, -1, 0])
        return 1

    def alternative() -> int:
        outputs, _ = peer(x[windows])
        backward(outputs[:, -1, 0])
        return 1

    print_row(f"LTC, {len(windows)} windows of {WINDOW} frames, both ways; ncps", ours, alternative)


def pyg_gcn(*, normalize: bool) -> pyg.PyG:
    """Return the network GCN by PyTorch Geometric.

    With `normalize`, each layer computes the weights of the edges again.
    """
    options = {"normalize": normalize}
    settings = pyg.Options(layer="GCNConv", layer_options=options, semantics=1.0)
    return pyg.PyG(FEATURES, settings).to(DEVICE)


def normalised_once(net: pyg.PyG, batch: GraphBatch) -> Tensor:
    """Return the features [B,F] of a batch; the weights of its edges are computed only once."""
    x = node_features(batch.xyz, batch.cls, net.semantics)
    edges, weights = gcn_norm(batch.edge_index, None, len(x))
    for layer in net.layers:
        x = layer(x, edges, weights).relu()
    return net.read_out(mean_max_pool(x, batch.ptr))


def ncps_ltc() -> nn.Module:
    """Return the LTC network of ncps on a wiring of the same sizes."""
    wiring = NCP(
        inter_neurons=12,
        command_neurons=6,
        motor_neurons=1,
        sensory_fanout=6,
        inter_fanout=4,
        recurrent_command_synapses=6,
        motor_fanin=6,
    )
    return ncps_torch.LTC(FEATURES, wiring, batch_first=True).to(DEVICE)


def window_rows() -> tuple[Tensor, Tensor]:
    """Return the rows of all windows' frames, int64 [W,T], and their time steps in seconds."""
    rows = torch.arange(FRAMES, device=DEVICE).unfold(0, WINDOW, 1)
    return rows, torch.full(rows.shape, 0.1, device=DEVICE)


def train_step(optimiser: torch.optim.Optimizer, output: Tensor) -> None:
    """Take a step towards an output of 0."""
    optimiser.zero_grad()
    backward(output)
    optimiser.step()


def backward(output: Tensor) -> None:
    """Compute the gradients of the squared output."""
    output.square().sum().backward()  # type: ignore[no-untyped-call]


def print_row(title: str, ours: Work, alternative: Work) -> None:
    """Print the median times of both sides.

    Each side runs once to warm up. Then they run in turn, so that other load affects both.
    """
    ours()
    alternative()
    times_ms = [(milliseconds(ours), milliseconds(alternative)) for _ in range(ROUNDS)]
    ours_ms, alternative_ms = np.median(times_ms, axis=0)
    ratio = f"{alternative_ms / ours_ms:.3g}"
    print(f"| {title} | {ours_ms:.3g} | {alternative_ms:.3g} | {ratio} |", flush=True)


def milliseconds(work: Work) -> float:
    """Return the time of `work` per item in milliseconds."""
    start_s = now_s()
    items = work()
    return 1e3 * (now_s() - start_s) / items


def now_s() -> float:
    """Return the time in seconds, after the device has finished its work."""
    if DEVICE == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def write_street(folder: Path) -> Path:
    """Write a graph file of a random street. Frames have different points."""
    path = folder / "street.h5"
    rng = np.random.default_rng(0)
    assert VARIANT.points
    graphs = []
    for number in range(FRAMES):
        cloud = street_frames.draw_street(VARIANT.points, rng)
        graphs.append(frame_graph.build_frame(cloud, VARIANT, path.stem, number))

    numbers = np.arange(FRAMES)
    params = {"graphs": VARIANT.model_dump()}
    with graph_file.create_graphs(path, drive=path.stem, params=params) as file:
        empty = frame_graph.empty_frame(cloud.at(np.arange(0)), VARIANT)
        graph_file.write_frames(file, numbers, numbers * 0.1, graphs, empty)
    return path


def read_graphs(street: Path, frames: int) -> GraphBatch:
    """Return the first frames of a graph file as a batch for a graph network."""
    with graph_file.open_graphs(street) as file:
        arrays = number_rows(join_frames([(file, 0, frames)]))
        batch = from_arrays(arrays, DEVICE)
    assert isinstance(batch, GraphBatch)
    return batch


def fit_wheel(time_s: np.ndarray, measured_rad: np.ndarray, wheel_rad: np.ndarray) -> np.ndarray:
    """Return the steering wheel's angle [F] from measured angles of the front wheels [F], in rad.

    Gain, offset and lag are those with the least squared error in the first FITTED_S seconds.
    """
    fitted = time_s < FITTED_S
    least_error = np.inf
    for lag_s in LAGS_S:
        lagged_rad = np.interp(time_s + lag_s, time_s, measured_rad)
        gain, offset_rad = np.polyfit(lagged_rad[fitted], wheel_rad[fitted], deg=1)
        angle_rad = gain * lagged_rad + offset_rad
        error = np.mean((angle_rad - wheel_rad)[fitted] ** 2)
        if error < least_error:
            least_error = error
            best_rad = angle_rad
    return best_rad


def udacity(motion: Path, csv: Path, leaderboard: Path) -> None:
    """Compare the command steer measure with three teams by the angle of the steering wheel.

    MOTION is the table that the command wrote of the drive's video. CSV has the time_s of the
    video's frames, and wheel_rad from the CAN bus, left positive. LEADERBOARD has the predictions
    of the teams for the same frames: komanda_rad, rambo_rad and autumn_rad. Writes
    out/udacity.json.
    """
    log = pd.read_csv(csv)
    time_s = log["time_s"].to_numpy()
    wheel_rad = log["wheel_rad"].to_numpy()
    table = pd.read_csv(motion)

    # Frames without a measured angle get an interpolated angle.
    measured = table.dropna(subset="measured_rad")
    measured_rad = np.interp(time_s, measured["time_s"], measured["measured_rad"])
    angles = pd.read_csv(leaderboard).drop(columns="time_s")
    angles["steer measure"] = fit_wheel(time_s, measured_rad, wheel_rad)

    print("| wheel's angle | RMSE rad |\n|---|--:|")
    results = {}
    for column, angle_rad in angles.items():
        error_rad = (angle_rad - wheel_rad)[time_s >= FITTED_S]
        rmse_rad = float(np.sqrt((error_rad**2).mean()))
        name = str(column).removesuffix("_rad")
        results[name] = {"value": rmse_rad}
        print(f"| {name} | {rmse_rad:.4f} |")
    content = {"preset": "udacity", **describe_origin(), "results": results}
    store.write_json(Path("out/udacity.json"), content, sort_keys=False)


if __name__ == "__main__":
    console.run(networks, udacity)
