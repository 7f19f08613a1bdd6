"""Deep Q-networks: Q-learning with a network, a replay and a slowly moving target.

``update`` is the rule alone, a pure function of parameters and a batch. ``dqn`` is the whole learner.

Mnih et al., *Human-level control through deep reinforcement learning*, 2015; Van Hasselt, Guez and Silver, *Deep
Reinforcement Learning with Double Q-learning*, 2016.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from jaxq import optimisers, policies, replay, rules, schedules
from jaxq.networks import Network
from jaxq.types import Agent, Array, Clock, Key, Metrics, PyTree, Transition


class DQNHypers(NamedTuple):
    """The numbers of a DQN, all [], all may be traced.

    The learning rate goes in a straight line to ``learning_rate_end`` over ``anneal_updates`` updates. Epsilon goes
    from start to end; ``epsilon_decay`` is the scale of the exponential or the horizon of the line, in environment
    steps.
    The target moves by ``tau`` every ``target_period`` updates: soft with a small tau and period 1, hard with tau 1.
    """

    learning_rate: Array
    learning_rate_end: Array
    anneal_updates: Array
    weight_decay: Array
    gamma: Array
    tau: Array
    target_period: Array
    epsilon_start: Array
    epsilon_end: Array
    epsilon_decay: Array
    huber_delta: Array
    clip_at: Array


class DQNState(NamedTuple):
    """Parameters of the online and of the target network, the optimiser's state, and the replay."""

    online: PyTree
    target: PyTree
    opt_state: PyTree
    replay: replay.Replay


class Updated(NamedTuple):
    """What one update returns."""

    online: PyTree
    target: PyTree
    opt_state: PyTree
    metrics: Metrics


def update(
    online: PyTree,
    target: PyTree,
    opt_state: PyTree,
    batch: Transition,
    *,
    apply: Callable[[PyTree, PyTree], Array],
    optimiser: optax.GradientTransformation,
    gamma: Array | float,
    tau: Array | float,
    loss: Callable[[Array], Array] = optax.losses.l2_loss,
    double: bool = False,
) -> Updated:
    """One gradient step on a batch, then one step of the target towards the new parameters.

    delta = r_t + gamma continues_t v_t - q(obs_tm1)[a_tm1];  v_t = max_a q'(obs_t)[a], or with ``double``
    q'(obs_t)[argmax_a q(obs_t)[a]];  L = mean loss(delta);  target <- (1 - tau) target + tau online,
    with q of ``online`` and q' of ``target``. The gradient flows through q(obs_tm1) alone.

    Shapes: batch [B]; ``apply(params, obs)`` of one observation -> [A], any function; loss: delta [B] -> [B]; gamma and
    tau []. ``metrics.loss`` is L; ``metrics.max_q`` is the mean over the batch of max_a q'(obs_t)[a]. Both are taken
    before the step. Mnih et al., 2015; Van Hasselt et al., 2016; soft target: Lillicrap et al., 2016.
    """
    values = jax.vmap(apply, in_axes=(None, 0))
    q_t = values(target, batch.obs_t)
    greedy_t = jax.vmap(rules.greedy_value)(q_t)
    v_t = jax.vmap(rules.double_value)(q_t, values(online, batch.obs_t)) if double else greedy_t
    target_tm1 = jax.vmap(rules.td_target)(batch.r_t, gamma * batch.continues_t, v_t)

    def objective(params: PyTree) -> Array:
        return jnp.mean(loss(jax.vmap(rules.td_error)(values(params, batch.obs_tm1), batch.a_tm1, target_tm1)))

    value, grads = jax.value_and_grad(objective)(online)
    steps, opt_state = optimiser.update(grads, opt_state, online)
    online = optax.apply_updates(online, steps)
    target = rules.polyak_update(online, target, tau)
    return Updated(online, target, opt_state, Metrics(loss=value, max_q=jnp.mean(greedy_t)))


def dqn(
    hypers: DQNHypers,
    *,
    network: Network,
    num_actions: int,
    batch_size: int,
    buffer_size: int,
    replacement: bool = False,
    double: bool = False,
    loss: str = "huber",
    epsilon_schedule: str = "exponential",
    clip: str = "none",
    optimiser: Callable[[Array, Array], optax.GradientTransformation] = optimisers.adamw,
) -> Agent:
    """A DQN learner: epsilon-greedy acting, uniform replay, one gradient step per update.

    ``loss`` is "huber" (0.5 d^2 up to ``huber_delta``, then its tangent; with 1 PyTorch's SmoothL1Loss) or "squared"
    (0.5 d^2). ``epsilon_schedule`` is "exponential" or "linear". ``clip`` bounds the gradient at ``clip_at``: "value"
    each entry, "norm" the global norm, or "none". ``optimiser(learning_rate, weight_decay)`` makes a transformation
    whose step is proportional to the learning rate. Network of observations obs -> [num_actions].

    Schedules read the clock: epsilon ``clock.env_steps``, the learning rate and the target ``clock.updates`` (updates
    done before this one). ``clock.live`` multiplies the learning rate and tau, so 0 leaves both networks as they are,
    bit for bit. Raises ValueError for an unknown name, for a batch larger than the buffer, and in ``init`` when the
    network's output is not [num_actions].
    """
    _one_of("loss", loss, ("huber", "squared"))
    _one_of("epsilon_schedule", epsilon_schedule, ("exponential", "linear"))
    _one_of("clip", clip, ("value", "norm", "none"))
    memory = replay.uniform(buffer_size, batch_size, replacement=replacement)

    def make_optimiser(learning_rate: Array) -> optax.GradientTransformation:
        step = optimiser(learning_rate, hypers.weight_decay)
        if clip == "value":
            return optax.chain(optax.clip(hypers.clip_at), step)
        if clip == "norm":
            return optax.chain(optax.clip_by_global_norm(hypers.clip_at), step)
        return step

    def loss_of(errors: Array) -> Array:
        if loss == "huber":
            return optax.losses.huber_loss(errors, delta=hypers.huber_delta)
        return optax.losses.l2_loss(errors)

    def init(key: Key, example: Transition) -> DQNState:
        online = network.init(key, example.obs_tm1)
        shape = jax.eval_shape(network.apply, online, example.obs_tm1).shape
        if shape != (num_actions,):
            raise ValueError(f"the network must return one value per action, shape ({num_actions},), got {shape}")
        return DQNState(online, online, make_optimiser(hypers.learning_rate).init(online), memory.init(example))

    def exploration(clock: Clock) -> Array:
        schedule = schedules.exponential if epsilon_schedule == "exponential" else schedules.linear
        return schedule(clock.env_steps, hypers.epsilon_start, hypers.epsilon_end, hypers.epsilon_decay)

    def act(key: Key, state: DQNState, obs: PyTree, clock: Clock) -> Array:
        return policies.epsilon_greedy(key, network.apply(state.online, obs), exploration(clock))

    def observe(state: DQNState, experience: Transition) -> DQNState:
        transitions = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), experience)
        return state._replace(replay=memory.add(state.replay, transitions))

    def learn(key: Key, state: DQNState, experience: Transition, clock: Clock) -> tuple[DQNState, Metrics]:
        stored = observe(state, experience).replay
        learning_rate = schedules.linear(
            clock.updates, hypers.learning_rate, hypers.learning_rate_end, hypers.anneal_updates
        )
        tau = rules.periodic_step(clock.updates, hypers.target_period, hypers.tau)
        online, target, opt_state, metrics = update(
            state.online,
            state.target,
            state.opt_state,
            memory.sample(key, stored),
            apply=network.apply,
            optimiser=make_optimiser(learning_rate * clock.live),
            gamma=hypers.gamma,
            tau=tau * clock.live,
            loss=loss_of,
            double=double,
        )
        return DQNState(online, target, opt_state, stored), metrics

    return Agent(
        init=init,
        act=act,
        exploration=exploration,
        update=learn,
        observe=observe,
        policy=lambda state: state.online,
        q_values=network.apply,
    )


def _one_of(field: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{field} must be one of {', '.join(allowed)}, got {value!r}")
