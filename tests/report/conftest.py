"""Results as the other packages make them: a two-inertia rig that lacks Coulomb friction."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

HOSTILE = "</script><b>x</b>&amp;[red]%{y}\x1b[31m"
CHANNELS = (("load_angle", "rad"), ("drive_speed", "rad/s"))

Curves = dict[str, NDArray[Any]]
Case = tuple[dict[str, Any], Curves]


@lru_cache(maxsize=8)
def simulated(seed: int, friction: float, damping: float) -> NDArray[np.float64]:
    """Return (time, load angle, drive speed, input, load speed) of a two-inertia rig."""
    dt, steps = 1e-3, 8000
    time = np.arange(steps) * dt
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2 * np.pi, 5)
    input_ = sum(
        0.5 * np.sin(2 * np.pi * f * time + p)
        for f, p in zip((0.35, 0.6, 1.1, 1.9, 3.1), phase, strict=True)
    )
    x = np.zeros(4)
    rows = np.empty((steps, 5))
    for i in range(steps):
        drive, load, w_drive, w_load = x
        rows[i] = time[i], load, w_drive, input_[i], w_load
        twist = 120.0 * (drive - load) + 0.25 * (w_drive - w_load)
        brake = friction * np.tanh(w_load / 0.02) + damping * w_load + 2.0 * load
        w_drive += dt * (input_[i] - twist - 0.05 * w_drive) / 0.02
        w_load += dt * (twist - brake) / 0.05
        x = np.array([drive + dt * w_drive, load + dt * w_load, w_drive, w_load])
    return rows


def nrmse(measured: NDArray[np.float64], model: NDArray[np.float64]) -> float:
    """Return rms(measured - model) / rms(measured - mean)."""
    return float(np.sqrt(np.mean((measured - model) ** 2)) / np.std(measured))


def correlations(residual: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normalised correlation at lags 0 to 80."""
    a, b = residual - residual.mean(), other - other.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    return np.array([a[lag:] @ b[: len(b) - lag] / scale for lag in range(81)])


@lru_cache(maxsize=1)
def realistic_curves() -> Curves:
    """Return the curves of two records, the second one a test record."""
    curves: Curves = {"records": np.array(2)}
    kept: list[NDArray[np.float64]] = []
    for k, seed in enumerate((1, 2)):
        truth = simulated(seed, 0.3, 0.12)
        noise = np.random.default_rng(seed).normal(size=(len(truth), 2)) * (0.002, 0.03)
        measured = (truth[:, 1:3] + noise)[::2]
        before, after = (simulated(seed, f, d)[::2, 1:3] for f, d in ((0.0, 0.34), (0.298, 0.121)))
        curves |= {f"{k}.time": truth[::2, 0], f"{k}.measured": measured}
        curves |= {f"{k}.before": before, f"{k}.after": after, f"{k}.input": truth[::2, 3:4]}
        kept += [measured - before, measured - after, truth[::2]]
    curves["inputs"] = np.array(["motor"])
    band = np.full(2, 2.58 / np.sqrt(4000.0))
    residuals = dict(zip(("_before", ""), kept[:2], strict=True))
    for name, residual in residuals.items():
        curves[f"residual.acf{name}"] = np.stack([correlations(r, r) for r in residual.T])
        curves[f"residual.ccf{name}"] = np.stack(
            [correlations(r, kept[2][:, 3]) for r in residual.T]
        )
    curves |= {"residual.acf_band": band, "residual.ccf_band": band}
    curves["residual.lag"] = np.arange(81) * 0.002
    curves["spectrum.frequency"] = np.fft.rfftfreq(4000, 0.002)[:800]
    for name, residual in zip(("before", "after"), kept[:2], strict=True):
        curves[f"spectrum.{name}"] = np.abs(np.fft.rfft(residual.T))[:, :800] / 1e3
    speed, position = kept[2][:, 4], kept[2][:, 1]
    scatter = np.random.default_rng(3).normal(size=len(speed)) * 0.05
    x = np.linspace(speed.min(), speed.max(), 200)
    curves |= {
        "latent.joints": np.array(["drive", "load"]),
        "latent.kinds": np.array(["hinge", "hinge"]),
        "latent.load.position": position,
        "latent.load.speed": speed,
        "latent.load.force": -0.3 * np.tanh(speed / 0.02) + scatter,
        "latent.load.time": kept[2][:, 0],
        "latent.drive.position": position,
        "latent.drive.speed": kept[2][:, 2],
        "latent.drive.force": scatter,
        "law.x": x,
        "law.y": -0.298 * np.tanh(x / 0.02),
        "law.label": np.array("Coulomb friction, 0.298 N m"),
    }
    return curves


def channel_entries(errors: tuple[float, float], good: bool, prefix: str) -> list[dict[str, Any]]:
    """Return the errors of the two channels."""
    return [
        {
            "name": prefix + name,
            "nrmse": error,
            "fit_percent": 100.0 * (1.0 - error),
            "rmse": 0.4 * error,
            "unit": unit,
            "residual_white": good,
            "input_correlated": not good,
        }
        for (name, unit), error in zip(CHANNELS, errors, strict=True)
    ]


def parameter(prefix: str, name: str, value: float, std: float | None, unit: str) -> dict[str, Any]:
    """Return one parameter."""
    return {
        "name": prefix + name,
        "value": value,
        "std_error": std,
        "unit": unit,
        "initial": round(value * 1.4, 3),
        "lower": 0.0,
        "upper": None,
        "note": prefix,
    }


def effect(prefix: str, name: str, place: str, *parameters: dict[str, Any]) -> dict[str, Any]:
    """Return one effect."""
    return {
        "effect": name,
        "location": prefix + place,
        "parameters": list(parameters),
        "representation": "native",
    }


class Factory:
    """Makes a result of each schema; every name starts with `prefix`."""

    def __init__(self, prefix: str = "") -> None:
        self.prefix = prefix
        curves = realistic_curves()
        self.errors = {
            side: [
                tuple(
                    nrmse(curves[f"{k}.measured"][:, c], curves[f"{k}.{side}"][:, c])
                    for c in range(2)
                )
                for k in range(2)
            ]
            for side in ("before", "after")
        }

    def curves(self) -> Curves:
        """Return the curves under the prefixed names."""
        curves = dict(realistic_curves())
        names = [self.prefix + str(name) for name in curves["latent.joints"]]
        for old, new in zip(curves["latent.joints"], names, strict=True):
            for key in ("position", "speed", "force", "time"):
                if f"latent.{old}.{key}" in curves:
                    curves[f"latent.{new}.{key}"] = curves[f"latent.{old}.{key}"]
        curves["latent.joints"] = np.array(names)
        curves["inputs"] = np.array([self.prefix + "motor"])
        curves["law.label"] = np.array(self.prefix + "Coulomb friction, 0.298 N m")
        return curves

    def friction(self) -> dict[str, Any]:
        """Return the effect that is missing."""
        force = parameter(self.prefix, "force", 0.2983, 0.0021, "N m") | {"initial": 0.0}
        return effect(self.prefix, "coulomb_friction", "load", force)

    def parameters(self) -> list[dict[str, Any]]:
        """Return the parameters of the rig."""
        p = self.prefix
        return [
            parameter(p, "drive.damping", 0.0512, 0.0011, "N m s/rad"),
            parameter(p, "load.damping", 0.1208, 0.0042, "N m s/rad"),
            parameter(p, "load.stiffness", 2.004, 0.012, "N m/rad"),
            parameter(p, "shaft.stiffness", 119.6, 0.9, "N m/rad"),
            parameter(p, "shaft.damping", 0.0, None, "N m s/rad"),
        ]

    def records(self, side: str) -> list[dict[str, Any]]:
        """Return the two records with the errors of one model."""
        good = side == "after"
        return [
            {
                "path": f"{self.prefix}records/{name}.csv",
                "role": role,
                "channels": channel_entries(self.errors[side][k], good, self.prefix),
            }
            for k, (name, role) in enumerate((("multisine_a", "train"), ("multisine_b", "test")))
        ]

    def channels(self, side: str) -> list[dict[str, Any]]:
        """Return the worst errors over the records."""
        pair = self.errors[side]
        worst = (max(pair[0][0], pair[1][0]), max(pair[0][1], pair[1][1]))
        return channel_entries(worst, side == "after", self.prefix)

    def named(self, errors: tuple[float, float]) -> dict[str, float]:
        """Return errors by channel name."""
        return {self.prefix + n: e for (n, _), e in zip(CHANNELS, errors, strict=True)}

    def common(self) -> dict[str, Any]:
        """Return what every result carries."""
        p = self.prefix
        return {
            "notes": [
                p + "Column 'temperature' matches nothing in the model and was ignored.",
                p + "load.mass was left out: it acts only together with load.inertia.",
            ],
            "simulation": {
                "backend": "compiled",
                "timestep": 0.001,
                "substeps": 2,
                "integration_error": 3.1e-6,
                "confirmed": True,
            },
        }

    def where(self) -> dict[str, Any]:
        """Return where the base model fails."""
        p = self.prefix
        return {
            "joints": [{"name": p + "load", "share": 0.93}, {"name": p + "drive", "share": 0.07}],
            "times": [
                {"start": s, "end": s + 2.0, "share": x}
                for s, x in ((0.0, 0.21), (2.0, 0.34), (4.0, 0.18), (6.0, 0.27))
            ],
            "bands": [
                {"low_hz": 0.1, "high_hz": 1.0, "share": 0.71},
                {"low_hz": 1.0, "high_hz": 10.0, "share": 0.27},
                {"low_hz": 10.0, "high_hz": 250.0, "share": 0.02},
            ],
            "position_speed": [{"joint": p + "load", "speed": 0.0, "position": 0.1, "share": 0.4}],
        }

    def candidates(self) -> list[dict[str, Any]]:
        """Return a ranking, the right effect first."""
        p, before = self.prefix, self.errors["before"][0]
        stribeck = [
            parameter(p, "force", 0.291, 0.011, "N m"),
            parameter(p, "static_force", 0.302, 0.019, "N m"),
            parameter(p, "stribeck_velocity", 0.05, None, "rad/s"),
        ]
        ranked = [
            ([self.friction()], 3e-31, 0.011, 0.996),
            ([effect(p, "stribeck_friction", "load", *stribeck)], 2e-30, 0.011, 0.996),
            (
                [effect(p, "quadratic_drag", "load", parameter(p, "drag", 0.08, 0.002, "N m s²"))],
                2.2e-5,
                0.121,
                0.4,
            ),
            (
                [
                    effect(p, "backlash", "shaft", parameter(p, "gap", 0.004, 0.001, "rad")),
                    effect(p, "input_offset", "motor", parameter(p, "offset", 0.02, 0.01, "N m")),
                ],
                0.041,
                0.158,
                0.1,
            ),
        ]
        twins = [[{"effect": "stribeck_friction", "location": p + "load"}]]
        return [
            {
                "effects": effects,
                "p_value": p_value,
                "nrmse_before": self.named(before),
                "nrmse_after": self.named((error, error * 0.9)),
                "indistinguishable_from": twins if i == 0 else [],
                "explained": explained,
            }
            for i, (effects, p_value, error, explained) in enumerate(ranked)
        ]

    def comparison(self) -> Case:
        """Return a comparison of the base model."""
        result = {
            "schema": "physid.comparison/1",
            "channels": self.channels("before"),
            "records": self.records("before"),
            "where": self.where(),
            "parameters": self.parameters(),
            **self.common(),
        }
        return result, {k: v for k, v in self.curves().items() if "after" not in k}

    def fit(self) -> Case:
        """Return a fit of the base model."""
        result = {
            "schema": "physid.fit/1",
            "parameters": self.parameters(),
            "channels": self.channels("before"),
            "records": self.records("before"),
            "status": self.prefix + "converged: the cost falls by less than 1e-9.",
            "force_balance": {
                "residual": {self.prefix + "load": 0.12},
                "parameters": self.parameters()[:2],
            },
            **self.common(),
        }
        return result, {k: v for k, v in self.curves().items() if "after" not in k}

    def diagnosis(self) -> Case:
        """Return a diagnosis that names Coulomb friction."""
        result = {
            "schema": "physid.diagnosis/1",
            "verdict": "effect_missing",
            "sentence": "",
            "channels": self.channels("before"),
            "records": self.records("before"),
            "where": self.where(),
            "parameters": self.parameters(),
            "candidates": self.candidates(),
            "next_experiment": {
                "sentence": self.prefix + "Drive the load slowly through zero speed.",
                "excite": "chirp:low=0.05,high=0.5",
                "separates": ["coulomb_friction@load", "stribeck_friction@load"],
            },
            **self.common(),
        }
        return result, self.curves()

    def refinement(self) -> Case:
        """Return a refinement in one step."""
        before, after = self.errors["before"], self.errors["after"]
        result = {
            "schema": "physid.refinement/1",
            "verdict": "effect_missing",
            "remaining": "nothing_missing",
            "steps": [
                {
                    "added": [],
                    "train": self.named(before[0]),
                    "test": self.named(before[1]),
                    "p_value": None,
                },
                {
                    "added": [self.friction()],
                    "train": self.named(after[0]),
                    "test": self.named(after[1]),
                    "p_value": 3e-31,
                },
            ],
            "parameters": [
                *self.parameters(),
                parameter(self.prefix, "coulomb_friction@load.force", 0.2983, 0.0021, "N m")
                | {"initial": 0.0},
            ],
            "channels": self.channels("after"),
            "where": self.where(),
            "candidates": self.candidates(),
            "records": self.records("after"),
            "model": "refined.xml",
            **self.common(),
        }
        return result, self.curves()

    def check(self) -> Case:
        """Return a check in which one parameter deviates."""
        rows = [("load.damping", 0.1208, 0.12), ("load.stiffness", 2.004, 2.0)]
        rows.append(("shaft.stiffness", 112.0, 120.0))
        entries = [
            {
                "name": self.prefix + name,
                "value": value,
                "truth": truth,
                "deviation": value / truth - 1.0,
                "holds": abs(value / truth - 1.0) <= 0.03,
            }
            for name, value, truth in rows
        ]
        result = {
            "schema": "physid.check/1",
            "holds": False,
            "within": 0.03,
            "parameters": entries,
            "records": self.records("after"),
            **self.common(),
        }
        return result, {}


@pytest.fixture(scope="session")
def hostile() -> str:
    """Return a name that tries to break out of HTML, JSON, hover templates and the terminal."""
    return HOSTILE


KINDS = ("comparison", "fit", "diagnosis", "refinement", "check")


@pytest.fixture(scope="session")
def factory() -> Callable[[str], Factory]:
    """Return the maker of factories by prefix."""
    return Factory


@pytest.fixture(params=KINDS)
def case(request: pytest.FixtureRequest) -> Case:
    """Return a realistic result of each schema, and its curves."""
    made: Case = getattr(Factory(), request.param)()
    return made


@pytest.fixture(params=KINDS)
def hostile_case(request: pytest.FixtureRequest) -> Case:
    """Return a result in which every name tries to break out."""
    made: Case = getattr(Factory(HOSTILE), request.param)()
    return made
