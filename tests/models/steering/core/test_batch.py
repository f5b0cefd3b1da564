import torch

from models.steering.core.batch import ImageBatch


def test_batch_moves_all_its_tensors(make_batch):
    batch = make_batch([5, 3]).to("meta")
    assert batch.frames == 2
    assert {getattr(batch, name).device.type for name in ("xyz", "cls", "ptr", "degree", "indices")} == {"meta"}


def test_batches_of_sets_and_images_move_all_their_tensors(make_sets):
    batch = make_sets([9, 5]).to("meta")
    tensors = [batch.xyz, batch.cls, batch.ptr]
    tensors += [getattr(level, name) for level in batch.levels for name in ("centres", "neighbours", "ptr")]
    assert {tensor.device.type for tensor in tensors} == {"meta"}
    assert ImageBatch(torch.zeros(1, 2, 3, 3)).to("meta").image.is_meta
