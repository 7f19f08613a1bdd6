"""TensorBoard's event files, read back by hand: a lane's episodes and curve with their tags and steps."""

import dataclasses
import math
import struct
from collections import defaultdict

import numpy as np
import pytest
from tensorboardX.crc32c import crc32c
from tensorboardX.proto.event_pb2 import Event

import jaxq
from jaxq import commands, run_files, sweeps, tensorboard
from jaxq.cli import main
from jaxq.plans import plan
from jaxq.stages import Listeners

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

NETWORK = {
    "hidden": (8,),
    "batch_size": 16,
    "learning_starts": 32,
    "buffer_size": 300,
    "max_env_steps": 700,
    "eval_episodes": 3,
    "eval_every": 250,
}
TABLE = {"max_episodes": 30, "eval_episodes": 3}


def events(file):
    """The records of a file: length, masked CRC of the length, data, masked CRC of the data."""
    data, found = file.read_bytes(), []

    def masked(part):
        crc = crc32c(part)
        return ((crc >> 15) | (crc << 17)) + 0xA282EAD8 & 0xFFFFFFFF

    while data:
        (length, check), body = struct.unpack("<QI", data[:12]), data[12:]
        assert check == masked(data[:8])
        assert struct.unpack("<I", body[length : length + 4]) == (masked(body[:length]),)
        found.append(Event.FromString(body[:length]))
        data = body[length + 4 :]
    assert found[0].file_version == "brain.Event:2"
    return found[1:]


def told(folder):
    """Scalars by tag as (step, value), and texts by tag."""
    (file,) = folder.iterdir()
    scalars, texts = defaultdict(list), {}
    for event in events(file):
        for value in event.summary.value:
            if value.HasField("tensor"):
                texts[value.tag] = value.tensor.string_val[0].decode()
            else:
                scalars[value.tag].append((event.step, value.simple_value))
    return dict(scalars), texts


@pytest.fixture(scope="module", params=["q-learning", "article-dqn"])
def lanes(request):
    """The lanes of a short sweep as they ended, and the plan."""
    values = TABLE if request.param == "q-learning" else NETWORK
    kept, planned = [], plan(request.param, seeds=2, gamma=[0.9, 0.99], **values)
    sweeps.run(planned, tell=Listeners(result=kept.append))
    return kept, planned


def pairs(steps, values):
    """As a file has them: float32, and only what there is."""
    return [(int(s), float(np.float32(v))) for s, v in zip(steps, values, strict=True) if math.isfinite(v)]


def test_tags_steps_and_values_are_those_of_the_lane(lanes, tmp_path):
    for i, result in enumerate(lanes[0]):
        tensorboard.write(tmp_path / str(i), result, lanes[1].settings[result.lane.config])
        scalars, _ = told(tmp_path / str(i))
        done, curve = result.episodes, result.curve
        assert len(done.total) > 3
        assert scalars.pop("charts/episodic_return") == pairs(done.env_steps, done.total)
        assert scalars.pop("charts/episodic_length") == pairs(done.env_steps, done.length)
        assert scalars.pop("losses/td_loss") == pairs(curve.env_steps, curve.loss)
        assert scalars.pop("losses/q_values") == pairs(curve.env_steps, curve.max_q)
        assert scalars.pop("charts/epsilon") == pairs(curve.env_steps, curve.epsilon)
        final = (result.env_steps, float(np.float32(np.mean(result.eval_returns))))
        assert scalars.pop("eval/episodic_return") == [*pairs(curve.env_steps, curve.eval_return), final]
        assert scalars == {}


def test_hyperparameters_are_a_text_with_each_by_name(lanes, tmp_path):
    kept, planned = lanes
    one = planned.settings[kept[-1].lane.config]
    tensorboard.write(tmp_path / "lane", kept[-1], one)
    _, texts = told(tmp_path / "lane")
    (text,) = texts.values()
    lines = dict(line.strip().split(" = ") for line in text.splitlines())
    assert list(lines) == list(one.fields())
    assert float(lines["gamma"]) == one.gamma
    assert lines["env.length"] == "0.5"
    assert lines["env"] == "CartPole-v1"


def test_evaluations_on_the_way_are_there_and_a_lane_without_an_evaluation_has_none(lanes, tmp_path):
    kept, planned = lanes
    result = kept[0]
    tensorboard.write(tmp_path / "lane", result, planned.settings[0])
    on_the_way = told(tmp_path / "lane")[0]["eval/episodic_return"]
    assert len(on_the_way) == (3 if planned.name == "article-dqn" else 1)
    curve = result.curve._replace(eval_return=np.full_like(result.curve.loss, np.nan))
    result = dataclasses.replace(result, eval_returns=None, curve=curve)  # as of a diverged lane
    tensorboard.write(tmp_path / "diverged", result, planned.settings[0])
    assert "eval/episodic_return" not in told(tmp_path / "diverged")[0]


def test_the_command_writes_a_folder_per_lane_and_replaces_those_of_an_earlier_try(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = "q-learning --max-episodes 20 --eval-episodes 2 --gamma 0.9 0.99 --seeds 2 --tensorboard --quiet".split()
    assert main(["sweep", *words, "--out", "run"]) == 0
    capsys.readouterr()
    board = tmp_path / "run" / run_files.TENSORBOARD
    assert sorted(folder.name for folder in board.iterdir()) == ["0-0", "0-1", "1-0", "1-1"]
    rows = {f"{row['config']}-{row['seed']}": row for row in jaxq.load("run").lanes.to_pylist()}
    for folder in board.iterdir():
        scalars, texts = told(folder)
        row = rows[folder.name]
        assert len(scalars["charts/episodic_return"]) == row["episodes"] == 20
        assert scalars["charts/episodic_return"][-1][0] == row["env_steps"]
        assert scalars["eval/episodic_return"] == [(row["env_steps"], pytest.approx(row["eval_return"]))]
        assert f"gamma = {row['gamma']}" in next(iter(texts.values()))
    before = {folder.name: told(folder) for folder in board.iterdir()}
    assert main(["sweep", *words, "--out", "run", "--overwrite"]) == 0
    assert {folder.name: told(folder) for folder in board.iterdir()} == before
    assert run_files.foreign(tmp_path / "run") == set()


def test_a_lane_that_ends_twice_leaves_one_file(lanes, tmp_path):
    kept, planned = lanes
    board = commands._board(tmp_path, planned)
    board(kept[0])
    (folder,) = (tmp_path / run_files.TENSORBOARD).iterdir()
    (folder / "events.out.tfevents.1.earlier").write_bytes(b"")  # the names tell seconds apart, no more
    board(kept[0])
    assert folder.name == f"{kept[0].lane.config}-{kept[0].lane.seed}"
    assert len(list(folder.iterdir())) == 1
