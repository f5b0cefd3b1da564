"""Encoders: one interface, tiny random networks of Hugging Face, published ones against truth."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
import transformers
from torch import nn

from models.encoder import hugging_face
from models.encoder.efficientvit import HEAD_WIDTH, LinearAttention
from models.encoder.heads import CellClasses, Pointwise, ray_slopes
from models.encoder.rtmonodepth_s import SIZE
from models.encoder.street import Street
from models.encoder.unified_encoder import Architecture, build_network
from pipeline.base.checkout import ROOT
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, scan_depth
from pipeline.camera.images import read_image, resize_image
from pipeline.encoder.create import create_encoder
from pipeline.encoder.encoder_file import load_encoder, save_encoder
from pipeline.encoder.settings import Encoder
from pipeline.ingest.datasets.kitti import KittiDrive, read_scan
from pipeline.perception.perceive import perceive
from pipeline.scores.pixels import class_ious, compute_depth_errors, count_confusion, crop_eigen
from tests.artefacts import Trap

# As published checkpoints write them.
CITYSCAPES = {number: name.title() for number, name in enumerate(classes.NAMES)}
DINOV2 = {
    "hidden_size": 24,
    "num_hidden_layers": 4,
    "num_attention_heads": 2,
    "image_size": 70,
    "patch_size": 14,
}
VIT = {
    "hidden_size": 24,
    "num_hidden_layers": 4,
    "num_attention_heads": 2,
    "intermediate_size": 32,
    "image_size": 64,
}
SEGFORMER = {"hidden_sizes": [8, 8, 16, 16], "depths": [1] * 4, "num_attention_heads": [1, 1, 2, 2]}


def write_networks(folder: Path) -> Path:
    """Write folders of networks. Returns `folder`."""
    torch.manual_seed(0)
    networks = {"dinov2": transformers.Dinov2Model(transformers.Dinov2Config(**DINOV2))}

    # Networks of depth.
    backbone = {
        **DINOV2,
        "out_indices": [1, 2, 3, 4],
        "apply_layernorm": True,
        "reshape_hidden_states": False,
    }
    fusion = {"neck_hidden_sizes": [8, 8, 16, 16], "fusion_hidden_size": 8}
    for name, kind in {"depth": "metric", "relative": "relative"}.items():
        config = transformers.DepthAnythingConfig(
            backbone_config=transformers.Dinov2Config(**backbone),
            depth_estimation_type=kind,
            max_depth=80,
            reassemble_hidden_size=24,
            **fusion,
        )
        networks[name] = transformers.DepthAnythingForDepthEstimation(config)

    # Networks of classes.
    segformer = {**SEGFORMER, "decoder_hidden_size": 16}
    config = transformers.SegformerConfig(**segformer, id2label=CITYSCAPES)
    networks["classes"] = transformers.SegformerForSemanticSegmentation(config)
    networks["headless"] = transformers.SegformerModel(config)
    labels = {number: CITYSCAPES[18 - number] for number in CITYSCAPES}
    config = transformers.SegformerConfig(**segformer, id2label=labels)
    networks["reversed"] = transformers.SegformerForSemanticSegmentation(config)
    # Its images have the size of the training images.
    config = transformers.DPTConfig(
        **VIT, **fusion, backbone_out_indices=[0, 1, 2, 3], id2label=CITYSCAPES
    )
    networks["dpt"] = transformers.DPTForSemanticSegmentation(config)

    # A backbone.
    config = transformers.SwinConfig(
        embed_dim=12, depths=[1] * 4, num_heads=[1, 2, 3, 4], drop_path_rate=0.0
    )
    networks["swin"] = transformers.SwinModel(config)
    for name, network in networks.items():
        network.save_pretrained(folder / name)
    images = {"do_normalize": True, "image_mean": [0.4, 0.5, 0.6], "image_std": [0.1, 0.2, 0.3]}
    (folder / "depth/preprocessor_config.json").write_text(json.dumps(images))
    return folder


K = torch.tensor([[[50.0, 0.0, 30.0], [0.0, 40.0, 20.0], [0.0, 0.0, 1.0]]])
Create = Callable[..., tuple[Architecture, nn.Module]]
# Backbone → the networks that it has by default.
DEFAULTS = {"pair": {"depth": "depth", "classes": "classes"}, "hugging_face": {"model": "swin"}}
FIT = {"frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_networks(tmp_path_factory.mktemp("networks"))


@pytest.fixture(scope="module")
def create(folder) -> Create:
    def create(kind: str, **names: str) -> tuple[Architecture, nn.Module]:
        names = DEFAULTS[kind] | names
        folders = {key: str(folder / name) for key, name in names.items()}
        epochs = int(kind == "hugging_face")
        settings = Encoder(backbone=kind, focal_by_width=0.5, epochs=epochs, **folders, **FIT)
        architecture, network = create_encoder(settings)
        return architecture, network.eval()

    return create


def image(size: tuple[int, int], count: int = 1) -> torch.Tensor:
    rng = torch.Generator().manual_seed(1)
    return torch.randint(0, 256, (count, 3, *size), dtype=torch.uint8, generator=rng)


def padded(
    size: tuple[int, int], mean: list[float], std: list[float], multiple: int
) -> torch.Tensor:
    """Return the image, normalised and padded to a multiple of pixels."""
    height, width = size
    pixels = image(size) / 255 - torch.tensor(mean).view(3, 1, 1)
    normalised = pixels / torch.tensor(std).view(3, 1, 1)
    return F.pad(normalised, (0, -width % multiple, 0, -height % multiple))


@pytest.mark.parametrize("size", [(64, 96), (37, 63)])
@pytest.mark.parametrize("kind", ["small", "street", "pair", "swin", "dinov2"])
@torch.no_grad()
def test_each_pixel_has_depth_and_classes_whatever_the_batch(create, kind, size):
    torch.manual_seed(0)
    if kind in ("small", "street"):
        network = build_network({"backbone": kind}).eval()
    elif kind == "pair":
        _, network = create("pair")
    else:
        _, network = create("hugging_face", model=kind)
    images = image(size, 2)
    depth, logits = network(images, K.expand(2, 3, 3))
    assert depth.shape == (2, *size)
    assert logits.shape == (2, classes.COUNT, *size)
    assert depth.min() > 0
    alone = network(images[1:], K)
    torch.testing.assert_close((depth[1:], logits[1:]), alone, rtol=1e-4, atol=1e-3)
    with torch.autocast("cpu", torch.bfloat16):  # as perception.precision: auto on a GPU
        coarse, _ = network(images, K.expand(2, 3, 3))
    assert ((coarse / depth).log().abs() < 0.1).all()


@pytest.mark.parametrize("size", [(64, 96), (50, 75)])
@torch.no_grad()
def test_a_pair_equals_the_networks_themselves(create, folder, size):
    height, width = size
    _, pair = create("pair")
    depth, logits = pair(image(size), K)

    network = transformers.DepthAnythingForDepthEstimation.from_pretrained(folder / "depth")
    rgb = padded(size, [0.4, 0.5, 0.6], [0.1, 0.2, 0.3], 28)
    expected = network(rgb).predicted_depth[:, :height, :width]
    torch.testing.assert_close(depth, expected * (50 / width) / 0.5)

    network = transformers.SegformerForSemanticSegmentation.from_pretrained(folder / "classes")
    rgb = padded(size, [0.485, 0.456, 0.406], [0.229, 0.224, 0.225], 32)
    expected = network(rgb).logits.log_softmax(1)
    expected = F.interpolate(expected, rgb.shape[-2:], mode="bilinear")[..., :height, :width]
    torch.testing.assert_close(logits, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", ["pair", "hugging_face"])
@torch.no_grad()
def test_a_saved_encoder_needs_no_folder(create, kind, tmp_path):
    architecture, network = create(kind)
    save_encoder(tmp_path, architecture, network.state_dict())
    assert "networks" not in json.dumps(architecture)  # the folder's name
    _, saved = load_encoder(tmp_path / "encoder.pt")
    # With equal weights in the same memory order, not a bit differs.
    pixels = image((50, 75))
    expected = network.to(memory_format=torch.channels_last)(pixels, K)
    torch.testing.assert_close(saved.cpu()(pixels, K), expected, rtol=0, atol=0)


@torch.no_grad()
def test_the_encoder_of_the_sample_is_the_same_on_each_device(device):
    _, network = load_encoder(ROOT / "models/encoder/sample/encoder.pt")
    camera = Camera(K[0].numpy(), (96, 320))
    images = image(camera.size, 3).permute(0, 2, 3, 1).numpy()
    expected_m, expected_cls = perceive(network.cpu(), images, camera)
    depth_m, cls = perceive(network.to(device), images, camera)
    np.testing.assert_allclose(depth_m, expected_m, rtol=1e-3)
    assert (cls == expected_cls).mean() > 0.999


@pytest.mark.parametrize("model", ["swin", "dinov2"])
def test_a_fit_reaches_the_first_layer_of_a_backbone_and_both_heads(create, model):
    _, network = create("hugging_face", model=model)
    depth, logits = network(image((64, 96)), K)
    (depth.mean() + logits.std()).backward()
    gradients = {"backbone": 0.0, "depth_head": 0.0, "class_head": 0.0}
    for name, parameter in network.named_parameters():
        assert parameter.grad is None or parameter.grad.isfinite().all()
        if "patch_embeddings" in name or "sides" in name:
            part, *_ = name.split(".")
            gradients[part] += float(parameter.grad.abs().sum())
    assert min(gradients.values()) > 0


def test_a_folder_without_weights_is_a_random_backbone_but_no_pair(create, folder):
    for name, source in {"bare": "swin", "bare-depth": "depth"}.items():
        (folder / name).mkdir()
        (folder / name / "config.json").write_bytes((folder / source / "config.json").read_bytes())
    name = "embeddings.patch_embeddings.projection.weight"
    published = transformers.SwinModel.from_pretrained(folder / "swin").state_dict()[name]
    _, swin = create("hugging_face", model="swin")
    assert torch.equal(swin.backbone.state_dict()[f"network.swin.{name}"], published)
    _, bare = create("hugging_face", model="bare")
    assert not torch.equal(bare.backbone.state_dict()[f"network.swin.{name}"], published)
    with pytest.raises(ValueError, match=r"bare-depth.*no file named"):
        create("pair", depth="bare-depth")


@pytest.mark.parametrize(
    ("kind", "names", "message"),
    [
        ("pair", {"depth": "relative"}, "^depth: is no metric Depth Anything .got .*'relative'"),
        ("pair", {"depth": "classes"}, "^depth: is no metric Depth Anything .got 'segformer'"),
        ("pair", {"classes": "reversed"}, "^classes: has other classes .*got 19: bicycle, motorc"),
        (
            "pair",
            {"classes": "headless"},
            r"headless': its weights lack decode_head\.\S+, \d+ tensors in all",
        ),
        ("pair", {"depth": "nowhere"}, "nowhere' is not a folder with a config.json"),
    ],
)
def test_a_wrong_network_is_one_line(create, kind, names, message):
    with pytest.raises(ValueError, match=message) as raised:
        create(kind, **names)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("file", ["pytorch_model.bin", "trap.py"])
def test_files_of_a_network_run_no_code(create, folder, tmp_path, file):
    trap = folder / "trap"
    sprung = tmp_path / "sprung"
    shutil.rmtree(trap, ignore_errors=True)
    shutil.copytree(folder / "swin", trap, ignore=shutil.ignore_patterns("*.safetensors"))
    if file.endswith(".py"):
        (trap / file).write_text(f"import pathlib\npathlib.Path({str(sprung)!r}).touch()")
        config = {
            "model_type": "trap",
            "auto_map": {"AutoConfig": "trap.Trap", "AutoBackbone": "trap.Trap"},
        }
        (trap / "config.json").write_text(json.dumps(config))
    else:
        torch.save({"state_dict": Trap(sprung)}, trap / file)
    with pytest.raises(ValueError, match="cannot load"):
        create("hugging_face", model="trap")
    assert not sprung.exists()


def test_a_network_of_the_hub_names_its_revision(folder, monkeypatch):
    revision = str(folder / "swin")
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **options: revision)
    path, description, sources = hugging_face.describe_network("a/network")
    assert path == folder / "swin"
    assert description["config"]["model_type"] == "swin"
    assert sources == ["https://huggingface.co/a/network/tree/swin"]


def test_depth_of_streets_grows_with_the_focal_length_and_classes_do_not():
    torch.manual_seed(0)
    model = Street().eval()
    longer = K.clone()
    longer[:, :2, :2] *= 1.5
    with torch.no_grad():
        depth, logits = model(image((41, 75)), K)
        longer_depth, longer_logits = model(image((41, 75)), longer)
    torch.testing.assert_close(longer_depth, 1.5 * depth)
    torch.testing.assert_close(longer_logits, logits)


@torch.no_grad()
def test_heads_equal_torchs_own_layers_and_rays_those_of_the_camera():
    torch.manual_seed(0)
    features = torch.randn(2, 8, 5, 7)
    rays = ray_slopes(K, (18, 27))
    expected = geometry.camera_rays(K[0].numpy(), (18, 27))[..., :2]
    np.testing.assert_allclose(rays[0].permute(1, 2, 0), expected, atol=1e-6)

    layer = Pointwise(8, 3)
    torch.testing.assert_close(layer(features), F.conv2d(features, layer.weight, layer.bias))
    head = CellClasses(8, stride=4)
    cells = F.pixel_shuffle(head.layer(features), 4)
    torch.testing.assert_close(head(features, rays), cells[..., :18, :27])


def test_linear_attention_is_a_mean_of_values_weighted_by_products_of_keys_and_queries():
    torch.manual_seed(0)
    layer = LinearAttention(2 * HEAD_WIDTH).eval()
    layer.proj = nn.Identity()
    x = torch.randn(2, 2 * HEAD_WIDTH, 3, 5)
    with torch.no_grad():
        outputs = layer(x).flatten(2).split(HEAD_WIDTH, dim=1)
        qkv = layer.qkv(x)
        scales = torch.cat([qkv, layer.aggreg[0](qkv)], dim=1).flatten(2)
    heads = scales.split(3 * HEAD_WIDTH, dim=1)
    for head, output in zip(heads, outputs, strict=True):
        q, k, v = head.split(HEAD_WIDTH, dim=1)  # [2,16,15]
        weights = torch.einsum("bcn,bcm->bnm", k.relu(), q.relu())
        shares = weights / weights.sum(dim=1, keepdim=True)
        expected = torch.einsum("bcn,bnm->bcm", v, shares)
        torch.testing.assert_close(output, expected, rtol=1e-4, atol=1e-5)


@pytest.fixture(scope="module")
def street(real_weights) -> nn.Module:
    model = Street()
    model.load_published(real_weights)  # all tensors have to agree
    return model.eval()


@pytest.mark.slow
@pytest.mark.real
@pytest.mark.parametrize(
    ("drive", "most"), [("2011_09_26_drive_0005", 0.13), ("2011_10_03_drive_0042", 0.17)]
)
def test_published_weights_give_metric_depth_of_real_streets(street, real_half, drive, most):
    raw = KittiDrive(real_half / drive[:10] / f"{drive}_sync")
    number = raw.choose_camera([2, 0])
    camera = raw.read_camera(number)
    scaled = camera.scaled(SIZE)
    errors = []
    ratios = []
    for frame in list(raw.scans)[::10]:
        image = resize_image(read_image(raw.find_images(number)[frame], camera.size), SIZE)
        (depth,), _ = perceive(street, image[None], scaled)
        truth = scan_depth(read_scan(raw.scans[frame]), scaled)
        abs_rel, *_ = compute_depth_errors(crop_eigen(depth), crop_eigen(truth))
        errors.append(abs_rel)
        ratios.append(np.median(truth[truth > 0] / depth[truth > 0]))
    assert np.mean(errors) < most
    assert np.mean(ratios) == pytest.approx(1, abs=0.08)  # metres, without any scaling


# CamVid's label (0 sky, 1 building, 2 pole, 3 road, 4 pavement, 5 tree, 6 sign, 7 fence, 8 car, 9
# pedestrian, 10 bicyclist) of Cityscapes' classes; it has no wall, train and void.
VOID = classes.VOID
CAMVID = np.array([3, 4, 1, VOID, 7, 2, 6, 6, 5, 5, 0, 9, 10, 8, 8, 8, VOID, 10, 10])


@pytest.mark.slow
@pytest.mark.real
@pytest.mark.parametrize(("colour", "least"), [(True, 0.65), (False, 0.62)])
def test_published_weights_give_classes_of_camvids_streets(street, real_camvid, colour, least):
    matrix = 0
    camera = Camera(np.array([[400.0, 0, 240], [0, 400, 180], [0, 0, 1]]), (360, 480))
    for path in sorted((real_camvid / "images").glob("*.jpg"))[::3]:
        label = cv2.imread(str(real_camvid / f"labels/{path.stem}.png"), cv2.IMREAD_UNCHANGED)
        image = read_image(path, camera.size)
        if not colour:
            grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            image = np.repeat(grey[..., None], 3, axis=-1)
        _, (cls,) = perceive(street, image[None], camera)
        matrix += count_confusion(CAMVID[cls], np.where(label < 11, label, VOID))
    assert class_ious(matrix)[:11].mean() > least
