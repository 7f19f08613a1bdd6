"""Pictures of states, and the panel beside them, show what they should."""

import numpy as np
import pytest
from gymnasium.envs.toy_text.frozen_lake import MAPS

from jaxq import envs, frames
from jaxq.envs import AcrobotState, CartPoleState, MDPState, MountainCarState, PendulumState
from jaxq.frames import canvas
from jaxq.frames.panel import Moment, Scale, beside, fitted
from jaxq.worlds import WORLDS, CartPole, CliffWalking, FrozenLake, MountainCar, Taxi, world


def where(picture, color):
    """The middle (x, y) of a colour's pixels, and how many there are."""
    rows, columns = np.nonzero(np.all(picture == np.array(color), -1))
    return np.array([columns.mean(), rows.mean()]) if len(rows) else None, len(rows)


def cart(x=0.0, theta=0.0):
    return CartPoleState(x, 0.0, theta, 0.0, 0)


#: Two states of each world.
STATES = {
    "CartPole-v1": [CartPoleState(x, 0.0, 0.1, 0.0, 0) for x in (-1.0, 1.0)],
    "Acrobot-v1": [AcrobotState(angle, 0.5, 0.0, 0.0, 0) for angle in (0.0, 2.0)],
    "MountainCar-v0": [MountainCarState(x, 0.0, 0) for x in (-0.5, 0.3)],
    "Pendulum-v1": [PendulumState(angle, 0.0, 0) for angle in (0.0, 2.0)],
    "FrozenLake-v1": [MDPState(s, 0) for s in (0, 9)],
    "FrozenLake8x8-v1": [MDPState(s, 0) for s in (0, 60)],
    "CliffWalking-v1": [MDPState(s, 0) for s in (36, 5)],
    "Taxi-v4": [MDPState(s, 0) for s in (0, 333)],
}


@pytest.mark.parametrize("name", WORLDS)
def test_every_world_draws_its_states(name):
    one = world(name)
    first, other = (frames.draw(one, state) for state in STATES[name])
    for picture in (first, other):
        assert picture.dtype == np.uint8
        assert picture.shape == (*frames.size_of(one)[::-1], 3)
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 5
    assert np.any(first != other)
    assert frames.draw(one, STATES[name][0], size=(90, 60)).shape == (60, 90, 3)
    assert len(one.actions()) == envs.make(name).num_actions


def test_the_cart_goes_where_x_is_and_the_pole_leans_as_its_angle():
    middles = [where(frames.draw(CartPole(), cart(x)), canvas.INK)[0][0] for x in (-1.0, 0.0, 1.0)]
    assert middles[0] < middles[1] < middles[2]
    assert middles[1] == pytest.approx(299.5, abs=1)
    assert middles[2] - middles[1] == pytest.approx(middles[1] - middles[0], abs=1)
    for theta in (-0.2, 0.0, 0.2):
        pole, _ = where(frames.draw(CartPole(length=1.0), cart(0.0, theta)), canvas.BLUE)
        base, _ = where(frames.draw(CartPole(length=1.0), cart(0.0, theta)), canvas.YELLOW)
        lean = np.arctan2(pole[0] - base[0], base[1] - pole[1])
        assert lean == pytest.approx(theta, abs=0.03)
    lengths = [where(frames.draw(CartPole(length=length), cart()), canvas.BLUE)[1] for length in (0.25, 0.5)]
    assert 1.6 < lengths[1] / lengths[0] < 2.4


def test_links_rods_and_cars_are_where_they_are():
    down, up = (
        where(frames.draw(world("Acrobot-v1"), AcrobotState(angle, 0.0, 0, 0, 0)), canvas.ORANGE)[0][1]
        for angle in (0.0, np.pi)
    )
    assert down > up
    right, left = (
        where(frames.draw(world("Pendulum-v1"), PendulumState(angle, 0.0, 0)), canvas.BLUE)[0][0] for angle in (-1, 1)
    )
    assert right > 250 > left  # as Gymnasium draws it: angles grow to the left
    xs = [where(frames.draw(MountainCar(), MountainCarState(x, 0.0, 0)), canvas.BLUE)[0] for x in (-1.0, -0.52, 0.4)]
    assert xs[0][0] < xs[1][0] < xs[2][0]
    assert xs[1][1] > max(xs[0][1], xs[2][1])  # the valley is the lowest
    flags = [
        where(frames.draw(MountainCar(goal_position=g), MountainCarState(-0.5, 0.0, 0)), canvas.GREEN)[0][0]
        for g in (0.2, 0.5)
    ]
    assert flags[0] < flags[1]


@pytest.mark.parametrize(("one", "rows", "columns"), [(FrozenLake(), 4, 4), (CliffWalking(), 4, 12)], ids=str)
def test_the_walker_stands_in_its_cell(one, rows, columns):
    for s in range(rows * columns):
        picture = frames.draw(one, MDPState(s, 0))
        at, _ = where(picture, canvas.ORANGE)
        cell = (at / (picture.shape[1] / columns)).astype(int)
        assert (cell[1], cell[0]) == divmod(s, columns)


def test_taxi_shows_who_is_where():
    def picture(row, column, passenger, destination):
        return frames.draw(Taxi(), MDPState(((row * 5 + column) * 5 + passenger) * 4 + destination, 0))

    waits, rides = (where(picture(2, 2, passenger, 1), canvas.PINK)[0] for passenger in (0, 4))
    assert waits[0] < 100
    assert waits[1] < 100
    assert rides == pytest.approx([200, 190], abs=12)
    assert np.any(picture(2, 2, 0, 1) != picture(2, 2, 0, 2))


def test_what_bounds_an_episode_is_drawn_where_it_is():
    at = np.nonzero(np.all(frames.draw(CartPole(), cart()) == canvas.ORANGE, -1))[1]
    for side in (-1, 1):  # 600 pixels show 1.15 times the threshold on either side
        near = at[np.abs(at - (300 + side * 300 / 1.15)) < 4]
        assert len(near) * 2 == pytest.approx(len(at), rel=0.1)
    lines = [
        np.nonzero(np.all(frames.draw(CartPole(theta_threshold_radians=a), cart())[:200] == canvas.FAINT, -1))[1]
        for a in (0.2, 0.4)
    ]
    assert np.ptp(lines[0]) > 20
    assert np.ptp(lines[1]) == pytest.approx(np.ptp(lines[0]) * np.sin(0.4) / np.sin(0.2), rel=0.1)
    wall, _ = where(frames.draw(MountainCar(), MountainCarState(-0.5, 0.0, 0)), canvas.ORANGE)
    assert wall[0] < 60
    line, many = where(frames.draw(world("Acrobot-v1"), AcrobotState(0.0, 0.0, 0, 0, 0)), canvas.GREEN)
    assert line == pytest.approx([249.5, 250 - 500 / 4.5], abs=1.5)
    assert many > 500
    mark, _ = where(frames.draw(world("Pendulum-v1"), PendulumState(2.0, 0.0, 0)), canvas.GREEN)
    assert mark == pytest.approx([250, 50], abs=3)


def test_acrobots_links_swing_to_the_right_where_angles_grow():
    one = world("Acrobot-v1")
    for angles, foot in (((np.pi / 2, 0.0), (2, 0)), ((-np.pi / 2, np.pi / 2), (-1, -1))):
        at, _ = where(frames.draw(one, AcrobotState(*angles, 0, 0, 0)), canvas.ORANGE)
        assert at == pytest.approx([250 + foot[0] * 500 / 4.5, 250 - foot[1] * 500 / 4.5], abs=2)


@pytest.mark.parametrize("name", ["FrozenLake-v1", "FrozenLake8x8-v1"])
def test_the_lakes_holes_and_goal_are_where_gymnasium_has_them(name):
    rows = MAPS["4x4" if name == "FrozenLake-v1" else "8x8"]
    picture = frames.draw(world(name), MDPState(0, 0))
    each = picture.shape[0] / len(rows)
    for i, row in enumerate(rows):
        for j, letter in enumerate(row):
            cell = picture[int(i * each) : int((i + 1) * each), int(j * each) : int((j + 1) * each)]
            assert (where(cell, canvas.WATER)[1] > each) == (letter == "H"), (i, j)
            assert (where(cell, canvas.GREEN)[1] > each / 4) == (letter == "G"), (i, j)


def test_the_cliff_is_where_it_is():
    picture = frames.draw(CliffWalking(), MDPState(0, 0))
    for i in range(4):
        for j in range(12):
            cell = picture[60 * i : 60 * i + 60, 60 * j : 60 * j + 60]
            assert (where(cell, canvas.WATER)[1] > 1000) == (i == 3 and 0 < j < 11), (i, j)


def test_taxis_walls_and_destination_are_where_they_are():
    def pixel(x, y):
        return int((x + 0.1) / 5.2 * 400), int((y + 0.1) / 5.2 * 400)

    for destination, (i, j) in enumerate(((0, 0), (0, 4), (4, 0), (4, 3))):
        picture = frames.draw(Taxi(), MDPState(((2 * 5 + 2) * 5 + 4) * 4 + destination, 0))
        ringed = []
        for row, column in ((0, 0), (0, 4), (4, 0), (4, 3)):
            x, y = pixel(column + 0.5, row + 0.96)
            ringed.append(bool(np.all(picture[y - 2 : y + 3, x] == canvas.INK, -1).any()))
        assert ringed == [(i, j) == place for place in ((0, 0), (0, 4), (4, 0), (4, 3))]
    walls = set()
    for row in range(5):
        for column in range(4):
            x, y = pixel(column + 1, row + 0.25)
            if np.all(picture[y, x - 1 : x + 2] == canvas.INK, -1).any():
                walls.add((row, column))
    assert walls == {(0, 1), (1, 1), (3, 0), (4, 0), (3, 2), (4, 2)}


def test_what_has_no_picture_is_said():
    own = world(lambda length=0.5: envs.make("CartPole-v1", length=length))
    assert not frames.drawn(own)
    with pytest.raises(ValueError, match=r"^env: .* is not allowed: it has no pictures"):
        frames.draw(own, cart())
    with pytest.raises(ValueError, match="size: "):
        frames.draw(CartPole(), cart(), size=(0, 10))


# Panels


#: A frame of which each test changes something.
USUAL = {"values": np.array([1.0, 4.0]), "action": 1, "step": 7, "total": 2.5, "note": "", "episode": ""}


def panel(past=(1.0, 3.0), scale=(0.0, 10.0), words=("title", "left", "right"), **changed):
    return beside(None, Moment(**{**USUAL, **changed}), list(past), Scale(*scale), words)


@pytest.mark.parametrize(
    ("changed", "rows", "columns"),
    [
        ({"words": ("other", "left", "right")}, (8, 28), (0, 130)),
        ({"step": 8}, (28, 47), (0, 130)),
        ({"total": 3.5}, (28, 47), (130, 260)),
        ({"note": "truncated"}, (46, 66), (0, 130)),
        ({"episode": "episode 2 of 3"}, (46, 66), (130, 260)),
        ({"words": ("title", "west", "right")}, (72, 152), (0, 260)),
        ({"words": ("title", "left", "light")}, (72, 232), (0, 260)),
        ({"values": np.array([2.0, 4.0])}, (72, 152), (40, 260)),
        ({"values": np.array([1.0, 4.001])}, (152, 232), (180, 260)),
        ({"past": (1.0, 5.0)}, (258, 310), (0, 260)),
    ],
    ids=str,
)
def test_each_word_and_number_has_its_place(changed, rows, columns):
    at, to = np.nonzero(np.any(panel(**changed) != panel(), -1))
    assert len(at)
    assert rows[0] <= at.min() <= at.max() < rows[1]
    assert columns[0] <= to.min() <= to.max() < columns[1]


def test_the_curve_rises_where_values_grow():
    drawn = panel(past=[0.0] * 30 + [10.0] * 30)[258:]
    early, late = where(drawn[:, 20:110], canvas.BLUE), where(drawn[:, 150:240], canvas.BLUE)
    assert min(early[1], late[1]) > 50
    assert early[0][1] > late[0][1] + 20


def test_what_is_no_number_has_no_bar_and_leaves_a_gap():
    for value in (np.nan, np.inf):
        drawn = panel(values=np.array([value, 4.0]), past=[5.0] * 25 + [value] * 10 + [5.0] * 25)
        assert where(drawn[72:152], canvas.FAINT)[1] == 0
        assert where(drawn[152:232], canvas.BLUE)[1] > 100
        gap, sides = where(drawn[258:, 115:145], canvas.BLUE)[1], where(drawn[258:, 20:50], canvas.BLUE)[1]
        assert gap == 0
        assert sides > 20
        assert where(drawn[258:], canvas.BLUE)[1] < 3 * 260  # a line along, and none up


def test_after_a_termination_no_values_are_shown():
    drawn = panel(values=None, action=-1)
    assert where(drawn[72:232], canvas.FAINT)[1] == where(drawn[72:232], canvas.BLUE)[1] == 0
    assert np.all(drawn[72:232, 200:] == canvas.PAPER)
    assert where(panel()[72:232], canvas.FAINT)[1] > 100


def test_nothing_runs_out_of_the_panel_and_a_long_title_keeps_its_seed():
    long = "a world of one's own with a very long name-v1  setting 1000, seed "
    names = ("an action with a very long name", "b")
    drawn = panel(
        words=(f"{long}1", *names), values=np.array([-123456.789, 1.0]), total=-1234567.8, episode="episode 100 of 100"
    )
    for margin in (drawn[:, :10], drawn[:, -10:]):
        assert np.all(margin == canvas.PAPER)
    assert np.any(panel(words=(f"{long}1", *names))[:28] != panel(words=(f"{long}7", *names))[:28])


def test_many_actions_have_a_bar_each():
    middles = []
    for action in (0, 10, 39):
        drawn = panel(values=np.linspace(1, 9, 40), action=action, words=("title", *[""] * 40))
        assert np.all(drawn[72:232, -10:] == canvas.PAPER)
        middle, many = where(drawn[66:236], canvas.BLUE)
        assert many > 10
        middles.append(middle[1] + 66)
    assert middles == pytest.approx([74, 114, 230], abs=2)


def test_wide_pictures_are_made_smaller_and_keep_their_shape():
    assert fitted((720, 240)) == (640, 214)
    assert fitted((600, 400)) == (480, 320)
    assert beside(np.zeros((240, 720, 3), np.uint8), Moment(**USUAL), [], Scale(0, 1), ("", "", "")).shape[1] == 900


def test_bars_show_the_chosen_action_and_do_not_jump():
    scale = Scale(0.0, 10.0)
    shown = [
        beside(None, Moment(np.array(v), a, 1, 2.0, ""), [1.0], scale, ("title", "left", "right"))
        for v, a in (([9.0, 3.0], 0), ([9.0, 3.0], 1))
    ]
    chosen = [where(picture[60:240, 60:], canvas.BLUE)[0][1] for picture in shown]
    assert chosen[0] < chosen[1]
    named = [[where(panel(action=a)[top : top + 80, 14:40], canvas.BLUE)[1] > 5 for top in (72, 152)] for a in (0, 1)]
    assert named == [[True, False], [False, True]]
    widths = []
    for value in (2.0, 4.0, 8.0):
        moment = Moment(np.array([0.0, value]), 1, 1, 0.0, "")
        picture = beside(None, moment, [1.0], scale, ("title", "", ""))
        widths.append(int(np.all(picture[:240] == canvas.BLUE, -1).sum(1).max()))
    assert widths[1] == pytest.approx(2 * widths[0], abs=3)
    assert widths[2] == pytest.approx(2 * widths[1], abs=3)
