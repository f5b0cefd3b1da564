import torch

from models.steering.core.motion import COLUMNS, odd_and_even


def test_columns_are_of_order_one_and_the_odd_ones_are_odd():
    corner, motorway = [0.5, 0.6, 4.0, 1.0], [-0.01, -0.1, 36.0, 1.0]
    motion = torch.tensor([corner, motorway, [0.0] * COLUMNS, [-1.5, 0.0, 0.1, 0.0]])
    odd, even = odd_and_even(motion)
    assert odd.abs().max() <= 1 < even.max() < 3
    assert odd[0].min() > 0.8
    assert not torch.cat([odd[2], even[2]]).any()
    there, same = odd_and_even(motion * torch.tensor([-1.0, -1.0, 1.0, 1.0]))
    assert torch.equal(there, -odd)
    assert torch.equal(same, even)
