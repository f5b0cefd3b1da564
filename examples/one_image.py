"""Take the method step by step, from eight images of a street to a steering angle.

Run it in the repository's root: python -m examples.one_image
"""

from pathlib import Path

import numpy as np
import torch

from models.steering.core.features import mean_max_pool, node_features
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.spatial.gnn import normalised_adjacency
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import back_project
from pipeline.camera.images import read_image
from pipeline.clouds import cloud
from pipeline.encoder import encoder_file
from pipeline.graphs import graph, graph_file
from pipeline.perception.perceive import perceive
from pipeline.report import street_view
from pipeline.train import trained

torch.set_grad_enabled(False)

# The intrinsics of the camera in pixels.
K = np.array([[172.9, 0, 154.4], [0, 172.9, 44.95], [0, 0, 1]])

# The first network, the encoder, perceives depth and classes. The second network steers. Both were
# trained on the sample.
_, encoder = encoder_file.load_encoder(Path("models/encoder/sample/encoder.pt"))
model = trained.load_model("models/steering/sample", device="cpu")
gcn = model.net.spatial
standardise = model.net.scale  # features; model.scale, below, is the scale of the angle
ncp = model.net.temporal

# A window of eight images [8,H,W,3], and the depth in metres and the class of each of their pixels.
paths = sorted(Path("examples/street").glob("*.png"))
images = np.stack([read_image(path) for path in paths])
camera = Camera(K, images.shape[1:3])
depths_m, class_maps = perceive(encoder, images, camera)

rng = np.random.default_rng(0)
features = []
for depth_m, cls in zip(depths_m, class_maps, strict=True):
    # A point in metres for each pixel that is solid: neither sky, nor void, nor far away (eq. 6).
    solid = cloud.solid_pixels(depth_m, cls, max_depth_m=80)
    xyz = back_project(depth_m, K)[solid].astype(np.float32)  # [P,3]
    point_cls = cls[solid]  # [P]

    # A thousand random points are enough.
    drawn = cloud.draw_rows(len(xyz), 1000, rng)
    xyz = xyz[drawn]
    point_cls = point_cls[drawn]

    # Connect nearest neighbours, and remove four of five edges between classes (Fig. 3).
    neighbours = graph.nearest_neighbours(xyz, k=6)
    edges = graph.undirected(neighbours)
    pruned = graph.prune(edges, point_cls, keep_inter_class=0.2, rng=rng)

    # Six features of the position, such as its bearing, and one for each of 19 classes (eq. 7).
    x = node_features(torch.from_numpy(xyz), torch.from_numpy(point_cls), semantics=1.0)  # [P,25]

    # Graph convolutions mix the features of connected points (eq. 3).
    degree = torch.from_numpy(pruned.degree)
    indices = torch.from_numpy(pruned.indices)
    adjacency = normalised_adjacency(degree, indices, x.dtype)
    for layer in gcn.layers:
        x = layer(adjacency, x)

    # The mean and the maximum over all points, which are rows 0 to len(x), describe the image.
    pooled = mean_max_pool(x, torch.tensor([0, len(x)]))
    features.append(gcn.read_out(pooled))  # [1,32]

# The network over time reads the features of the window, and its last output is the angle. It is
# added to a base of 0, as no motion is measured here. The renderer's car steered by 17.1°.
inputs = ncp.project_inputs(standardise(torch.cat(features)))
outputs = ncp(inputs[None], torch.full((1, 8), NOMINAL_STEP_S))  # [1,8,1]
angle_rad = model.scale.decode(outputs[:, -1].numpy(), base=np.zeros(1))
angle_deg = np.degrees(angle_rad.item())
title = f"steering angle: predicted {angle_deg:.1f}°, driven 17.1° (left +)"
print(title)

# Draw the last image with its depth, classes and graph.
pairs = graph_file.edge_pairs(pruned.degree, pruned.indices)
view = street_view.View(
    frame=7,
    rgb=images[7],
    depth_m=depth_m,
    cls=cls,
    xyz=xyz,
    points_cls=point_cls,
    edges=pairs,
    edge_count=pruned.edges_kept,
)
street_view.save_figure(street_view.draw_sheet(title, view), Path("out/one_image.png"))
