"""The interface of all encoders; those of Hugging Face on tiny random networks in folders: nothing needs a hub."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.nn.functional as F
import transformers
from torch import nn

from models.encoder import hugging_face
from models.encoder.dinov2 import read_head
from models.encoder.hugging_face import NUMBERS, CityscapesLogits
from models.encoder.rtmonodepth_s import KITTI_FOCAL
from models.encoder.unified_encoder import Architecture, build
from pipeline.camera import classes
from pipeline.perception import perceive
from pipeline.perception.create import create as create_encoder
from pipeline.settings.encoder import Encoder
from tests import tiny_networks

K = torch.tensor([[[50.0, 0.0, 30.0], [0.0, 40.0, 20.0], [0.0, 0.0, 1.0]]])
SIZES = [(64, 96), (50, 75)]
Create = Callable[..., tuple[Architecture, nn.Module]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tiny_networks.write(tmp_path_factory.mktemp("networks"))


@pytest.fixture(scope="module")
def create(folder) -> Create:
    def create(kind: str, more: dict[str, str] = {}, **names: str) -> tuple[Architecture, nn.Module]:  # noqa: B006
        defaults = {
            "pair": {"depth": "depth", "classes": "classes"},
            "hugging_face": {"model": "swin"},
            "dinov2": {"model": "dinov2", "depth": "depth.pth", "classes": "classes.pth"},
        }
        values = {key: str(folder / name) for key, name in (defaults[kind] | names).items()} | more
        fit = {"epochs": int(kind == "hugging_face"), "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
        architecture, network = create_encoder(Encoder(backbone=kind, focal_by_width=0.5, **values, **fit))
        return architecture, network.eval()

    return create


def image(size: tuple[int, int], count: int = 1) -> torch.Tensor:
    return torch.randint(0, 256, (count, 3, *size), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))


def normalised(size: tuple[int, int], mean: list[float], std: list[float]) -> torch.Tensor:
    return (image(size) / 255 - torch.tensor(mean).view(3, 1, 1)) / torch.tensor(std).view(3, 1, 1)


@pytest.mark.parametrize("size", [(64, 96), (37, 63)])
@pytest.mark.parametrize("kind", ["small", "street", "pair", "hugging_face", "hugging_face on dinov2", "dinov2"])
@torch.no_grad()
def test_each_pixel_has_depth_and_classes_whatever_the_batch(create, kind, size):
    kind, _, model = kind.partition(" on ")
    names = {"model": model} if model else {}
    network = build({"backbone": kind}).eval() if kind in ("small", "street") else create(kind, **names)[1]
    images = image(size, 2)
    depth, logits = network(images, K.expand(2, 3, 3))
    assert depth.shape == (2, *size)
    assert logits.shape in {(2, classes.COUNT, *size), (2, classes.COUNT + 1, *size)}
    assert depth.min() > 0
    for a, b, c in zip((depth, logits), network(images[1:], K), network(images[1:] / 255, K), strict=True):
        torch.testing.assert_close(a[1:], b, rtol=1e-4, atol=1e-3)
        torch.testing.assert_close(b, c)
    with torch.autocast("cpu", torch.bfloat16):  # as perception.precision: auto on a GPU
        assert ((network(images, K.expand(2, 3, 3))[0] / depth).log().abs() < 0.1).all()


@pytest.mark.parametrize("size", SIZES)
@torch.no_grad()
def test_a_pair_equals_the_networks_themselves(create, folder, size, capsys):
    depth, logits = create("pair")[1](image(size), K)
    assert "that are void: zebra\n" in capsys.readouterr().out
    padded = F.pad(normalised(size, [0.4, 0.5, 0.6], [0.1, 0.2, 0.3]), (0, -size[1] % 28, 0, -size[0] % 28))
    expected = transformers.DepthAnythingForDepthEstimation.from_pretrained(folder / "depth")(padded).predicted_depth
    torch.testing.assert_close(depth, expected[:, : size[0], : size[1]] * (50 / size[1]) / 0.5)
    rgb = normalised(size, [0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
    padded = F.pad(rgb, (0, -size[1] % 32, 0, -size[0] % 32))
    own = transformers.SegformerForSemanticSegmentation.from_pretrained(folder / "classes")(padded).logits
    trained = torch.tensor([classes.ROAD, classes.VEGETATION, classes.SKY, classes.COUNT])[own.argmax(1)]
    assert (logits[:, :, 1:-2:4, 1:-2:4].argmax(1) == trained[:, : size[0] // 4, : size[1] // 4]).float().mean() > 0.8


@torch.no_grad()
def test_dinov2_has_the_depth_of_its_authors_formula(create, folder):
    """The features enlarged, then the convolution to bins; here the bins are enlarged."""
    network = create("dinov2")[1]
    padded = normalised((56, 84), [0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
    vit = transformers.Dinov2Model.from_pretrained(folder / "dinov2").eval()
    last = vit(padded, output_hidden_states=True).hidden_states[-1]
    both = torch.cat([last[:, 1:], last[:, :1].expand(-1, 24, -1)], dim=2).mT.reshape(1, 48, 4, 6)
    head = read_head(folder / "depth.pth")
    bins = F.conv2d(F.interpolate(both, scale_factor=4, mode="bilinear"), *head.values())
    shares = bins.relu() + 0.1
    depth = (shares * torch.linspace(0.001, 80, 256).view(-1, 1, 1)).sum(1) / shares.sum(1)
    depth = F.interpolate(depth[:, None], (56, 84), mode="bilinear")[:, 0]
    torch.testing.assert_close(network(image((56, 84)), K)[0], depth * (50 / 84) / KITTI_FOCAL, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", ["pair", "hugging_face", "dinov2"])
@torch.no_grad()
def test_a_saved_encoder_needs_no_folder(create, kind, tmp_path):
    architecture, network = create(kind)
    perceive.save(tmp_path, architecture, network.state_dict())
    assert "networks" not in json.dumps(architecture)  # the folder's name
    for a, b in zip(perceive.load(tmp_path)(image((50, 75)), K), network(image((50, 75)), K), strict=True):
        torch.testing.assert_close(a.cpu(), b)


@pytest.mark.parametrize("model", ["swin", "dinov2"])
def test_a_fit_reaches_the_first_layer_of_a_backbone_and_both_heads(create, model):
    network = create("hugging_face", model=model)[1]
    depth, logits = network(image((64, 96)), K)
    (depth.mean() + logits.std()).backward()
    parts = {name.split(".")[0]: 0.0 for name, _ in network.named_parameters()}
    for name, parameter in network.named_parameters():
        assert parameter.grad is None or parameter.grad.isfinite().all()
        if "patch_embeddings" in name or "sides" in name:
            parts[name.split(".")[0]] += float(parameter.grad.abs().sum())
    assert min(parts.values()) > 0


def test_a_folder_without_weights_is_a_random_backbone_but_no_pair(create, folder):
    for name, source in {"bare": "swin", "bare-depth": "depth"}.items():
        (folder / name).mkdir()
        (folder / name / "config.json").write_bytes((folder / source / "config.json").read_bytes())
    swin, bare = (create("hugging_face", model=name)[1].backbone.state_dict() for name in ("swin", "bare"))
    name = "embeddings.patch_embeddings.projection.weight"
    published = transformers.SwinModel.from_pretrained(folder / "swin").state_dict()[name]
    assert torch.equal(swin[f"network.swin.{name}"], published)
    assert not torch.equal(bare[f"network.swin.{name}"], published)
    with pytest.raises(ValueError, match=r"bare-depth.*no file named"):
        create("pair", depth="bare-depth")


def test_synonyms_are_of_cityscapes_ade20k_and_mapillary():
    assert all(NUMBERS[name] == number for number, name in enumerate(classes.NAMES))
    table = {
        "Tree": "vegetation", "grass": "terrain", "sidewalk": "sidewalk", "van": "car", "minibike": "motorcycle",
        "Bicyclist": "rider", "Street Light": "pole", "On Rails": "train", "signboard ": "traffic sign",
    }  # fmt: skip
    labels = [*table, "bridge", "LABEL_0"]
    mapped = CityscapesLogits(labels)(50 * torch.eye(len(labels))[..., None, None]).argmax(1).flatten().tolist()
    assert mapped == [classes.NAMES.index(name) for name in table.values()] + [classes.COUNT] * 2


@pytest.mark.parametrize(
    ("kind", "names", "message"),
    [
        ("pair", {"depth": "relative"}, "depth of '.*relative' is relative"),
        ("pair", {"depth": "glpn"}, "glpn' has an unknown unit.*depth_unit: metric"),
        ("pair", {"depth": "classes"}, "cannot load '.*classes'.*SegformerConfig"),
        ("pair", {"depth": "nowhere"}, "nowhere' is not a folder with a config.json"),
        ("hugging_face", {"model": "."}, "not a folder with a config.json"),
        ("dinov2", {"model": "swin"}, "swin': expected a network of type dinov2"),
        ("dinov2", {"depth": "none.pth"}, "cannot load '.*none.pth'.*No such file"),
    ],
)
def test_a_wrong_network_is_one_line(create, kind, names, message):
    with pytest.raises(ValueError, match=message) as raised:
        create(kind, **names)
    assert "\n" not in str(raised.value)


def test_a_network_that_needs_other_weights_than_its_folder_has_is_refused(create, folder):
    network = transformers.SegformerModel(transformers.SegformerConfig(**tiny_networks.SEGFORMER))
    network.save_pretrained(folder / "headless")
    with pytest.raises(ValueError, match=r"headless': its weights lack decode_head\.\S+, \d+ tensors in all"):
        create("pair", classes="headless")


class Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


@pytest.mark.parametrize(
    ("kind", "names", "file"),
    [
        ("hugging_face", {"model": "trap"}, "trap/pytorch_model.bin"),
        ("dinov2", {"depth": "trap/head.pth"}, "trap/head.pth"),
        ("hugging_face", {"model": "trap"}, "trap/trap.py"),
    ],
)
def test_files_of_a_network_run_no_code(create, folder, tmp_path, kind, names, file):
    trap, sprung = folder / "trap", tmp_path / "sprung"
    shutil.rmtree(trap, ignore_errors=True)
    shutil.copytree(folder / "swin", trap, ignore=shutil.ignore_patterns("*.safetensors"))
    if file.endswith(".py"):
        (folder / file).write_text(f"import pathlib\npathlib.Path({str(sprung)!r}).touch()")
        config = {"model_type": "trap", "auto_map": {"AutoConfig": "trap.Trap", "AutoBackbone": "trap.Trap"}}
        (trap / "config.json").write_text(json.dumps(config))
    else:
        torch.save({"state_dict": Trap(sprung)}, folder / file)
    with pytest.raises(ValueError, match="cannot load"):
        create(kind, **names)
    assert not sprung.exists()


def test_a_hub_out_of_reach_is_one_line(monkeypatch):
    import huggingface_hub

    def refuse(name: str, **_: Any) -> str:
        raise FileNotFoundError("cannot reach the hub\nPlease check your connection")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", refuse)
    with pytest.raises(ValueError, match=r"^cannot load 'a/network': cannot reach the hub$"):
        hugging_face.local("a/network")
