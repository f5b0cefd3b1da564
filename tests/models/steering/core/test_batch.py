import torch

from models.steering.core.batch import ImageBatch


def test_ptr_stays_on_the_cpu(make_batch, make_sets):
    batch = make_batch([5, 3]).to("meta")
    assert {getattr(batch, name).device.type for name in ("xyz", "cls", "degree", "indices")} == {"meta"}
    assert batch.ptr.tolist() == [0, 5, 8]
    batch = make_sets([9, 5]).to("meta")
    tensors = [batch.xyz, batch.cls]
    tensors += [getattr(level, name) for level in batch.levels for name in ("centres", "neighbours")]
    assert {tensor.device.type for tensor in tensors} == {"meta"}
    assert not any(ptr.is_meta for ptr in (batch.ptr, *(level.ptr for level in batch.levels)))
    assert ImageBatch(torch.zeros(1, 2, 3, 3)).to("meta").image.is_meta
