"""DQN updates in PyTorch on fixed weights and batches: the slow, independent reference.

Run it (in an environment with torch) to remake ``torch_updates.npz``, which ``tests/test_dqn.py`` replays:

    python tests/reference/torch_updates.py
"""

import pathlib

import numpy
import torch

UPDATES, BATCHES, BATCH_SIZE, GAMMA = 200, 20, 64, 0.99
# The tutorial's numbers; and a run where the gradients are clipped and AMSGrad's maximum decides the step.
SETTINGS = {
    "tutorial": {"learning_rate": 1e-4, "tau": 0.005, "clip": 100.0},
    "fast": {"learning_rate": 3e-3, "tau": 0.05, "clip": 0.003},
}


def network():
    """4-128-128-2 with ReLU and PyTorch's default initialisation."""
    return torch.nn.Sequential(
        torch.nn.Linear(4, 128),
        torch.nn.ReLU(),
        torch.nn.Linear(128, 128),
        torch.nn.ReLU(),
        torch.nn.Linear(128, 2),
    )


def make_batches():
    """Transitions with rewards around 1, some large, and one termination in ten."""
    rng = numpy.random.default_rng(0)
    shape = (BATCHES, BATCH_SIZE)
    return {
        "obs_tm1": rng.normal(size=(*shape, 4)).astype(numpy.float32),
        "a_tm1": rng.integers(0, 2, shape).astype(numpy.int32),
        "r_t": (1 + 2 * rng.standard_t(3, shape)).astype(numpy.float32),
        "continues_t": (rng.random(shape) > 0.1).astype(numpy.float32),
        "obs_t": rng.normal(size=(*shape, 4)).astype(numpy.float32),
    }


def run(batches, initial, learning_rate, tau, clip):
    """Parameters of both networks after all updates, and the losses."""
    online, target = network(), network()
    online.load_state_dict(initial)
    target.load_state_dict(initial)
    optimiser = torch.optim.AdamW(online.parameters(), lr=learning_rate, amsgrad=True)
    losses = []
    for index in range(UPDATES):
        batch = {name: torch.tensor(values[index % BATCHES]) for name, values in batches.items()}
        chosen = online(batch["obs_tm1"]).gather(1, batch["a_tm1"].long().unsqueeze(1)).squeeze(1)
        with torch.no_grad():
            value = target(batch["obs_t"]).max(1).values * batch["continues_t"]
        loss = torch.nn.SmoothL1Loss()(chosen, batch["r_t"] + GAMMA * value)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_value_(online.parameters(), clip)
        optimiser.step()
        kept, fresh = target.state_dict(), online.state_dict()
        target.load_state_dict({name: fresh[name] * tau + kept[name] * (1 - tau) for name in fresh})
        losses.append(loss.item())
    return online.state_dict(), target.state_dict(), numpy.array(losses, numpy.float32)


def main():
    torch.manual_seed(0)
    torch.set_num_threads(1)
    initial = network().state_dict()
    batches = make_batches()
    arrays = dict(batches)
    arrays |= {f"initial.{name}": value.numpy() for name, value in initial.items()}
    for setting, numbers in SETTINGS.items():
        online, target, losses = run(batches, initial, **numbers)
        arrays |= {f"{setting}.{name}": numpy.float32(value) for name, value in numbers.items()}
        arrays |= {f"{setting}.online.{name}": value.numpy() for name, value in online.items()}
        arrays |= {f"{setting}.target.{name}": value.numpy() for name, value in target.items()}
        arrays[f"{setting}.losses"] = losses
    numpy.savez_compressed(pathlib.Path(__file__).with_suffix(".npz"), **arrays)


if __name__ == "__main__":
    main()
