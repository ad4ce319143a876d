"""The nonlinear plants' equations written a second time, in another form than their C source: a mass matrix, solved by NumPy."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Given = Mapping[str, float]

PLANTS = Path(__file__).parents[1] / "fmus" / "plants"
GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class Model:
    """`slope(x, inputs)` and `observe(x, inputs)` are the derivatives of `states` and the values of `outputs`; `energy(x)` [J]."""

    input: str
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    slope: Callable[[Reals, Given], Reals]
    observe: Callable[[Reals, Given], Reals]
    energy: Callable[[Reals], float]


def parameters(plant: str) -> dict[str, float]:
    """The start values of a plant's parameters."""
    data = tomllib.loads((PLANTS / plant / "plant.toml").read_text(encoding="utf-8"))
    return {name: float(entry["start"]) for name, entry in data["parameters"].items()}


def gantry_crane() -> Model:
    """Lagrange's equations in the trolley's position x and the cable's angle θ, the cable's length L(t) given by the hoist."""
    p = parameters("gantry_crane")
    M, m, hoisting = p["trolley_mass"], p["load_mass"], p["hoist_bandwidth"]

    def accelerations(state: Reals, given: Given) -> Reals:
        _, v, angle, w, out, out_rate = state
        length, hoist = p["length"] + out, hoisting**2 * (given.get("hoist", 0.0) - out) - 2.0 * hoisting * out_rate
        s, c = np.sin(angle), np.cos(angle)
        # The load is at (x + L sin θ, -L cos θ); T = M v²/2 + m |its velocity|²/2.
        mass = np.array([[M + m, m * length * c], [m * length * c, m * length**2]])
        horizontal = m * (hoist * s + 2.0 * out_rate * w * c - length * w**2 * s)
        about = m * (2.0 * length * out_rate * w + GRAVITY * length * s)
        force = given["force"] - p["friction"] * v
        return np.append(np.linalg.solve(mass, [force - horizontal, -about]), hoist)

    def slope(state: Reals, given: Given) -> Reals:
        trolley, swing, hoist = accelerations(state, given)
        return np.array([state[1], trolley, state[3], swing, state[5], hoist])

    def observe(state: Reals, given: Given) -> Reals:
        x, _, angle, w, out, out_rate = state
        length = p["length"] + out
        trolley, swing, hoist = accelerations(state, given)
        s, c = np.sin(angle), np.cos(angle)
        # The cable's force on the load is m (acceleration + gravity), by Newton in Cartesian coordinates.
        sideways = trolley + hoist * s + 2 * out_rate * w * c + length * (swing * c - w**2 * s)
        upward = -hoist * c + 2 * out_rate * w * s + length * (swing * s + w**2 * c) + GRAVITY
        return np.array([x + length * s, length * s, length, m * np.hypot(sideways, upward)])

    def energy(state: Reals) -> float:
        _, v, angle, w, out, out_rate = state
        length, s, c = p["length"] + out, np.sin(angle), np.cos(angle)
        vx, vy = v + length * w * c + out_rate * s, length * w * s - out_rate * c
        return float(M * v**2 / 2 + m * (vx**2 + vy**2) / 2 - m * GRAVITY * length * c)

    states = ("position", "velocity", "sway_angle", "sway_rate", "payout", "payout_rate")
    return Model("force", states, ("load", "sway", "cable", "tension"), slope, observe, energy)


def robot_arm() -> Model:
    """Masses at points: a slender rod is a sixth of it at each end and two thirds in the middle, exactly (Simpson's rule)."""
    p = parameters("robot_arm")
    l1, l2 = p["length_1"], p["length_2"]
    rest = np.pi - np.arccos((l1**2 + l2**2 - p["reach"] ** 2) / (2 * l1 * l2))
    rods = [(p["mass_1"] * share, at * l1, 0.0) for share, at in ((1 / 6, 0), (2 / 3, 0.5), (1 / 6, 1))]
    rods += [(p["mass_2"] * share, l1, at * l2) for share, at in ((1 / 6, 0), (2 / 3, 0.5), (1 / 6, 1))]
    points = [*rods, (p["payload"], l1, l2)]  # mass, and how far along each link

    def jacobians(state: Reals) -> list[tuple[float, Reals, Reals]]:
        """For each point its mass, the Jacobian of its place (2, 2), and its acceleration at constant rates (2,)."""
        _, _, q1, w1, bend, w2 = state
        q12, found = q1 + rest + bend, []
        first, second = np.array([np.cos(q1), np.sin(q1)]), np.array([np.cos(q12), np.sin(q12)])
        turned = [np.array([-e[1], e[0]]) for e in (first, second)]
        for mass, a, b in points:
            jacobian = np.column_stack([a * turned[0] + b * turned[1], b * turned[1]])
            found.append((mass, jacobian, -a * first * w1**2 - b * second * (w1 + w2) ** 2))
        return found

    def joints(state: Reals) -> Reals:
        motor, rate, q1, w1, bend, w2 = state
        shoulder = p["stiffness_1"] * (motor - q1) + p["damping_1"] * (rate - w1)
        return np.array([shoulder, -p["stiffness_2"] * bend - p["damping_2"] * w2])

    def slope(state: Reals, given: Given) -> Reals:
        torques, parts = joints(state), jacobians(state)
        mass = np.sum([m * j.T @ j for m, j, _ in parts], axis=0)
        swing, bending = np.linalg.solve(mass, torques - np.sum([m * j.T @ a for m, j, a in parts], axis=0))
        return np.array([state[1], (given["torque"] - torques[0]) / p["motor_inertia"], state[3], swing, state[5], bending])

    def observe(state: Reals, given: Given) -> Reals:
        hands = [l1 + l2 * np.exp(1j * (rest + bend)) for bend in (0.0, state[4])]
        return np.array([state[2] + np.angle(hands[1] / hands[0]), joints(state)[0]])

    def energy(state: Reals) -> float:
        rates = state[[3, 5]]
        kinetic = sum(m * np.sum((j @ rates) ** 2) / 2 for m, j, _ in jacobians(state)) + p["motor_inertia"] * state[1] ** 2 / 2
        return float(kinetic + p["stiffness_1"] * (state[0] - state[2]) ** 2 / 2 + p["stiffness_2"] * state[4] ** 2 / 2)

    states = ("motor_angle", "motor_rate", "shoulder_angle", "shoulder_rate", "elbow_bend", "elbow_rate")
    return Model("torque", states, ("hand_angle", "joint_torque"), slope, observe, energy)


MODELS = {"gantry_crane": gantry_crane(), "robot_arm": robot_arm()}
