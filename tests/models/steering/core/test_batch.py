import torch

from models.steering.core.batch import ImageBatch


def test_a_batch_moves_but_for_where_frames_begin(make_batch):
    batch = make_batch([5, 3]).to("meta")
    assert batch.frames == 2
    assert {getattr(batch, name).device.type for name in ("xyz", "cls", "degree", "indices")} == {"meta"}
    assert batch.ptr.tolist() == [0, 5, 8]


def test_batches_of_sets_and_images_move_likewise(make_sets):
    batch = make_sets([9, 5]).to("meta")
    tensors = [batch.xyz, batch.cls]
    tensors += [getattr(level, name) for level in batch.levels for name in ("centres", "neighbours")]
    assert {tensor.device.type for tensor in tensors} == {"meta"}
    assert not any(ptr.is_meta for ptr in (batch.ptr, *(level.ptr for level in batch.levels)))
    assert ImageBatch(torch.zeros(1, 2, 3, 3)).to("meta").image.is_meta
