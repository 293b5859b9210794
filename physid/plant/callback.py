"""Run-time force laws inside the engine: one compiled passive-force callback.

MuJoCo calls ``mjcb_passive(model, data)`` at every evaluation, so laws are integrated by the engine
itself, RK4 stages included; so are their memories, activations whose rates it asks from
``mjcb_act_dyn(model, data, actuator)``.  The callbacks read its laws from a table at the end of the model's
numeric data.  Where MuJoCo keeps its arrays is found by scanning the structs of a probe model, so
no layout is assumed; a number drawn afresh in each process marks the tables, so a table in a file
from elsewhere is never obeyed.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.binding import add_symbol  # type: ignore[import-untyped]
from numba import carray, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from physid.errors import NumericsError
from physid.plant.compiling import kept, kept_c_function
from physid.plant.law import call_law, call_memory_law, pointer_at
from physid.plant.model import ELEMENT_WIDTH, JOINT_WIDTH, Plant

_MARK = ctypes.c_double()
_MARK_NAME = "physid_mark_of_this_process"


def _own_mark(typingctx):  # type: ignore[no-untyped-def]
    """Read this process's mark; compiled code that is kept finds it by name."""

    def codegen(context, builder, _signature, _arguments):  # type: ignore[no-untyped-def]
        known = builder.module.globals.get(_MARK_NAME)
        cell = known or ir.GlobalVariable(builder.module, ir.DoubleType(), _MARK_NAME)
        return builder.load(cell)

    return types.float64(), codegen


own_mark: Any = intrinsic(_own_mark)
_lock = threading.RLock()
_HEADER = 6  # address, offset, numbers of joints and constants, first activation, their number


def fill_table(plant: Plant, mark: float) -> None:
    """Write a plant's run-time laws into its model, where the callback looks for them."""
    model = plant.model
    table = model.numeric_data
    address_of = {int(model.jnt_dofadr[j]): int(model.jnt_qposadr[j]) for j in range(model.njnt)}
    for e, element in enumerate(plant.elements):
        rows = element.rows
        joints = [(address_of[d], d, *rows[:, d].tolist()) for d in element.joints.tolist()]
        entry: list[float] = [element.address, element.offset, len(joints), element.constants.size]
        entry += [element.activation, len(element.memory)]
        entry += [number for joint in joints for number in joint]
        entry += list(element.constants)
        start = table.size - 2 - ELEMENT_WIDTH * (e + 1)
        table[start : start + len(entry)] = entry
    table[-2:] = (mark, len(plant.elements))


@contextmanager
def run_time_laws(plants: list[Plant]) -> Iterator[None]:
    """Let the engine obey the run-time laws of some plants while the context is open."""
    with obeyed_laws(fill_tables(plants)):
        yield


def fill_tables(plants: Iterable[Plant]) -> bool:
    """Write the run-time laws of some plants into their models; say whether there are any."""
    lawful = [plant for plant in plants if plant.elements]
    for plant in lawful:
        fill_table(plant, _callbacks().mark)
    return bool(lawful)


@contextmanager
def obeyed_laws(lawful: bool) -> Iterator[None]:
    """Let the engine obey the laws that :func:`fill_tables` has written.

    For those who step one model many times: the tables are written once, the callback is installed
    only while the context is open, because it is the whole process's.
    """
    if not lawful:
        yield
        return
    callbacks = _callbacks()
    with _lock:
        mujoco.set_mjcb_passive(callbacks.passive.ctypes)
        mujoco.set_mjcb_act_dyn(callbacks.rate.ctypes)
        try:
            yield
        finally:
            mujoco.set_mjcb_passive(None)
            mujoco.set_mjcb_act_dyn(None)


def _find_pointer(address: int, target: int, words: int = 60000) -> int:
    memory = np.ctypeslib.as_array((ctypes.c_uint64 * words).from_address(address))
    for i in range(words):
        if memory[i] == target:
            while memory[i + 1] == target:
                i += 1
            return i
    raise NumericsError("This MuJoCo build keeps its arrays where physid cannot find them.")


@kept
def _count(table, mark, version):  # type: ignore[no-untyped-def]
    """Return the number of laws in a table, none if it is not this process's."""
    own = version > 0 and table.size >= 2 and table[table.size - 2] == mark
    return int(table[table.size - 1]) if own else 0


@kept
def _part(table, start, qpos, qvel, time, base, acts, part):  # type: ignore[no-untyped-def]
    """Return a law's force (part 0), or the rate of an entry of its memory (from part 1 on).

    ``base`` and ``acts`` are the addresses of the table and of the activations.
    """
    x, v, joints = -table[start + 1], 0.0, int(table[start + 2])
    for j in range(joints):
        at = start + _HEADER + JOINT_WIDTH * j
        x += table[at + 2] * qpos[int(table[at])]
        v += table[at + 3] * qvel[int(table[at + 1])]
    constants = pointer_at(base + 8 * (start + _HEADER + JOINT_WIDTH * joints))
    if table[start + 5] == 0:
        return call_law(np.int64(table[start]), x, v, time, constants)
    memory = pointer_at(acts + 8 * np.int64(table[start + 4]))
    return call_memory_law(np.int64(table[start]), x, v, time, constants, memory, np.int64(part))


class _Callbacks(NamedTuple):
    """What the engine calls for forces and for rates of memories, and the mark of this process."""

    passive: Any
    rate: Any
    mark: float


@lru_cache(maxsize=1)
def _callbacks() -> _Callbacks:
    marker = 1237
    probe = mujoco.MjModel.from_xml_string(
        "<mujoco><custom><numeric name='n' size='1237' data='0'/></custom><worldbody><body>"
        "<joint name='j' type='slide'/><geom size='1'/></body></worldbody><actuator>"
        "<general joint='j' dyntype='filter' dynprm='1'/></actuator></mujoco>"
    )
    data = mujoco.MjData(probe)
    model_words = np.ctypeslib.as_array((ctypes.c_int64 * 200).from_address(probe._address))
    size_at = int(np.flatnonzero(model_words == marker)[0])
    numbers_at = _find_pointer(probe._address, probe.numeric_data.ctypes.data)
    qpos_at = _find_pointer(data._address, data.qpos.ctypes.data)
    qvel_at = _find_pointer(data._address, data.qvel.ctypes.data)
    act_at = _find_pointer(data._address, data.act.ctypes.data)
    force_at = _find_pointer(data._address, data.qfrc_passive.ctypes.data)
    activation_at = _find_pointer(probe._address, probe.actuator_actadr.ctypes.data)
    mujoco.mj_step(probe, data)
    data.time = 12345.678
    words = np.ctypeslib.as_array((ctypes.c_double * 60000).from_address(data._address))
    time_at = int(np.flatnonzero(words == data.time)[0])
    _MARK.value = float(np.random.default_rng().uniform(1e9, 1e12))
    add_symbol(_MARK_NAME, ctypes.addressof(_MARK))
    # What the code takes from here, the engine's version and layout, keys the kept code.
    version = mujoco.mj_version()
    width, longest = ELEMENT_WIDTH, max(numbers_at, activation_at) + 1

    @kept_c_function(types.void(types.uintp, types.uintp))
    def passive(model_address, data_address):  # type: ignore[no-untyped-def]
        model = carray(pointer_at(np.int64(model_address)), (longest,)).view(np.int64)
        words = carray(pointer_at(np.int64(data_address)), (force_at + time_at,))
        pointers = words.view(np.int64)
        size = model[size_at]
        table = carray(pointer_at(model[numbers_at]), (size,))
        laws = _count(table, own_mark(), version)
        nv = model[1]
        qpos = carray(pointer_at(pointers[qpos_at]), (model[0],))
        qvel = carray(pointer_at(pointers[qvel_at]), (nv,))
        force = carray(pointer_at(pointers[force_at]), (nv,))
        for e in range(laws):
            start = size - 2 - width * (e + 1)
            acts, base = pointers[act_at], model[numbers_at]
            f = _part(table, start, qpos, qvel, words[time_at], base, acts, 0)
            for j in range(int(table[start + 2])):
                at = start + _HEADER + JOINT_WIDTH * j
                force[int(table[at + 1])] += table[at + 4] * f

    @kept_c_function(types.float64(types.uintp, types.uintp, types.int32))
    def rate(model_address, data_address, actuator):  # type: ignore[no-untyped-def]
        model = carray(pointer_at(np.int64(model_address)), (longest,)).view(np.int64)
        words = carray(pointer_at(np.int64(data_address)), (force_at + time_at,))
        pointers = words.view(np.int64)
        size = model[size_at]
        table = carray(pointer_at(model[numbers_at]), (size,))
        laws = _count(table, own_mark(), version)
        qpos = carray(pointer_at(pointers[qpos_at]), (model[0],))
        qvel = carray(pointer_at(pointers[qvel_at]), (model[1],))
        addresses = carray(pointer_at(model[activation_at]), (actuator + 1,)).view(np.int32)
        own = addresses[actuator]
        for e in range(laws):
            start = size - 2 - width * (e + 1)
            part = own - int(table[start + 4])
            if part >= 0 and part < int(table[start + 5]):
                acts, base = pointers[act_at], model[numbers_at]
                return _part(table, start, qpos, qvel, words[time_at], base, acts, part + 1)
        return 0.0

    return _Callbacks(passive, rate, _MARK.value)
