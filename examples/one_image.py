"""The method, step by step: eight images of a street to the steering angle. Run python -m
examples.one_image.
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
K = np.array([[172.9, 0, 154.4], [0, 172.9, 44.95], [0, 0, 1]])  # pixels
_, encoder = encoder_file.load(Path("models/encoder/sample/encoder.pt"))
model = trained.load("models/steering/sample", device="cpu")
gcn, standardise, ncp = model.net.spatial, model.net.scale, model.net.temporal
# [8,H,W,3]
images = np.stack([read_image(path) for path in sorted(Path("examples/street").glob("*.png"))])
rng, features = np.random.default_rng(0), []
# each [H,W]
for depth_m, cls in zip(*perceive(encoder, images, Camera(K, images.shape[1:3])), strict=True):
    solid = cloud.solid(depth_m, cls, max_depth_m=80)  # no sky, void or far pixels
    # eq. 6: metres [P,3], trainIds [P]
    xyz, point_cls = back_project(depth_m, K)[solid].astype(np.float32), cls[solid]
    drawn = cloud.draw(len(xyz), 1000, rng)
    xyz, point_cls = xyz[drawn], point_cls[drawn]
    # Fig. 3
    pruned = graph.prune(
        graph.undirected(graph.nearest(xyz, k=6)), point_cls, keep_inter_class=0.2, rng=rng
    )
    # eq. 7: [P,25]
    x = node_features(torch.from_numpy(xyz), torch.from_numpy(point_cls), semantics=1.0)
    adjacency = normalised_adjacency(
        torch.from_numpy(pruned.degree), torch.from_numpy(pruned.indices), x.dtype
    )
    for layer in gcn.layers:
        x = layer(adjacency, x)  # GCNLayer, eq. 3
    features.append(gcn.read_out(mean_max_pool(x, torch.tensor([0, len(x)]))))  # [1,32]
# [1,8,..], a window of eight frames
inputs = ncp.project_inputs(standardise(torch.cat(features)))[None]
outputs = ncp(inputs, torch.full((1, 8), NOMINAL_STEP_S))  # [1,8,1]
angle_deg = np.degrees(model.scale.decode(outputs[:, -1].numpy(), base=np.zeros(1)).item())
print(title := f"steering angle: predicted {angle_deg:.1f}°, driven 17.1° (left +)")
# A picture of the last image.
edges = graph_file.edge_pairs(pruned.degree, pruned.indices)
view = street_view.View(7, images[7], depth_m, cls, xyz, point_cls, edges, pruned.edges_kept)
street_view.save(street_view.sheet(title, view), Path("out/one_image.png"))
