"""What the input was before a record, which lags and delays remember."""

from dataclasses import replace

import numpy as np
import pytest

from physid.errors import ModelError
from physid.identification.beginnings import with_likely_beginnings
from physid.identification.staged import states_only
from physid.identification.study import Options, prepare
from physid.plant.simulation import Simulator, delayed
from physid.record.record import Record
from tests.effects.rigs import MOTOR, base, with_effect

DT, SAMPLES = 2e-3, 1500
SIGMA = 1e-4
LATE = {"input_delay": {"delay": 0.02}, "actuator_lag": {"time_constant": 0.02}}


def record_of(model, before):
    """Simulate a rig whose input is one from the start of the record, and whose input was 1 or 0 before."""
    rng = np.random.default_rng(3)
    switched = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 30), 30)
    history = np.full(500, switched[0] if before == "held" else 0.0)
    inputs = np.tile(np.concatenate([history, switched])[:, None], (1, len(model.structure.inputs)))
    simulator = Simulator(structure=model.structure, dt=DT, substeps=4)
    plant = model.compile(simulator.step)
    controls = simulator.controls([plant], inputs)
    initial = np.zeros((1, 2 * model.structure.nv + plant.model.na))
    run = simulator.run([plant], [initial], controls, np.zeros(1, int), len(inputs))[0]
    outputs = run.outputs[0, len(history) :]
    outputs = outputs + SIGMA * outputs.std(axis=0) * rng.standard_normal(outputs.shape)
    names = (*model.structure.inputs, *(c.name for c in model.structure.channels))
    values = np.hstack([inputs[len(history) :], outputs])
    return Record(time=DT * np.arange(SAMPLES), columns=names, values=values)


@pytest.mark.parametrize("effect", LATE)
@pytest.mark.parametrize("before", ["held", "zero"])
def test_the_record_tells_what_the_input_was_before(effect, before):
    model = with_effect(effect, MOTOR, **LATE[effect])
    study = prepare(model, [record_of(model, before)], Options(fit=[]))
    assert {w.simulator.before for w in study.problem.windows} == {before}
    told = [n for n in study.notes if "taken to have been 0 before the record" in n]
    assert len(told) == (before == "zero")
    problem = study.problem
    assert states_only(problem).squares < 1.5 * problem.measurements()
    other = [
        replace(w, simulator=replace(w.simulator, before="held" if before == "zero" else "zero"))
        for w in problem.windows
    ]
    wrong = problem.with_windows(other)
    assert states_only(wrong).squares > 2.0 * problem.measurements()
    again = with_likely_beginnings(wrong, np.zeros(0))
    assert [w.simulator.before for w in again.windows] == [before]
    assert again.on(other).windows[0].simulator.before == before


def test_a_model_that_remembers_no_input_keeps_its_beginning():
    study = prepare(base(), [record_of(base(), "zero")], Options(fit=[]))
    assert with_likely_beginnings(study.problem, np.zeros(0)) is study.problem


def test_a_delay_beyond_all_records_is_refused_in_a_sentence():
    with pytest.raises(ModelError, match=r"A delay of 1e\+30 s is more than 1e\+07 steps"):
        with_effect("input_delay", MOTOR, delay=1e30).compile(1e-3)


def test_a_signal_is_delayed_from_what_it_was_before():
    u = np.array([2.0, 2.0, 4.0])
    np.testing.assert_allclose(delayed(u, 1.5), [2.0, 2.0, 2.0])
    np.testing.assert_allclose(delayed(u, 1.5, "zero"), [0.0, 1.0, 2.0])
