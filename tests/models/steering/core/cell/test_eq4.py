import itertools

import numpy as np
import torch
from scipy.integrate import solve_ivp
from scipy.special import expit

from models.steering.core.cell.eq4 import Eq4
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.core.wiring import Layout, ncp

DT_S = torch.tensor([[0.1, 0.31, 0.02, 0.1], [0.08, 0.1, 0.12, 0.6]], dtype=torch.float64)
WIRING = ncp(5, Layout(inter=6, command=5, sensory_fanout=3, inter_fanout=3, motor_fanin=3), motor=2)


def cell_of(unfolds: int) -> Eq4:
    torch.manual_seed(0)
    cell = Eq4(WIRING, unfolds).double()
    with torch.no_grad():
        for parameter in cell.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return cell


def features():
    torch.manual_seed(1)
    return torch.randn(2, 4, 5, dtype=torch.float64)


def solved(cell: Eq4, x: np.ndarray, dt_s: np.ndarray) -> np.ndarray:
    """h after each of a window's frames, from eq. 4 written as sums over synapses and a solver of order 8."""
    synapses = [
        [(j, i, w) for (j, i), w in zip(np.argwhere(signs), matrix.w.tolist(), strict=True)]
        for signs, matrix in [(WIRING.sensory, cell.sensory), (WIRING.internal, cell.internal)]
    ]
    bias, theta = cell.bias.detach().numpy(), cell.theta.weight.detach().numpy()

    def slope(_, h, x_frame):
        change = bias - h
        for k, i, w in synapses[0]:
            change[i] += w * x_frame[k]
        for j, i, w in synapses[1]:
            change[i] += w * expit(h[j])
        return change / np.exp(theta @ x_frame)

    h, states = np.zeros(WIRING.units), []
    for x_frame, dt in zip(x, dt_s, strict=True):
        solution = solve_ivp(slope, (0, dt / NOMINAL_STEP_S), h, "DOP853", args=(x_frame,), rtol=1e-12, atol=1e-13)
        h = solution.y[:, -1]
        states.append(h)
    return np.array(states)


def test_small_steps_reach_the_ode_solvers_solution():
    x, unfolds = features(), [64, 128, 256, 512, 1024]
    exact = torch.from_numpy(np.stack([solved(cell_of(1), x[w].numpy(), DT_S[w].numpy()) for w in range(2)]))
    with torch.no_grad():
        runs = []
        for steps in unfolds:
            cell = cell_of(steps)
            out, (last,) = cell(cell.project_inputs(x), DT_S)
            y = exact[..., :2].sigmoid() * cell.output_scale + cell.output_shift
            runs.append(torch.cat([(out - y).flatten(), (last - exact[:, -1]).flatten()]))  # errors
    sizes = [run.abs().max().item() for run in runs]
    # Second order: half the step, a quarter of the error. Cancelling its terms in step², step³, … leaves the limit.
    assert all(3.7 < coarse / fine < 4.3 for coarse, fine in itertools.pairwise(sizes))
    for order in range(2, len(unfolds) + 1):
        runs = [(2**order * fine - coarse) / (2**order - 1) for coarse, fine in itertools.pairwise(runs)]
    assert sizes[-1] < 1e-7
    assert runs[0].abs().max() < 1e-9


def test_gradients():
    cell, x = cell_of(2), features().requires_grad_()
    dt_s = DT_S.clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x, dt_s, *_: cell(cell.project_inputs(x), dt_s)[0], (x, dt_s, *cell.parameters())
    )
