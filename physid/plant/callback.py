"""Run-time force laws inside the engine: one compiled passive-force callback.

MuJoCo calls ``mjcb_passive(model, data)`` at every evaluation, so laws are integrated by the engine
itself, RK4 stages included.  The callback reads its laws from a table at the end of the model's
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
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.binding import add_symbol  # type: ignore[import-untyped]
from numba import carray, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from physid.errors import NumericsError
from physid.plant.compiling import kept_c_function
from physid.plant.law import call_law, pointer_at
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


own_mark = intrinsic(_own_mark)
_lock = threading.RLock()
_HEADER = 4  # address, offset, number of joints, number of constants


def fill_table(plant: Plant, mark: float) -> None:
    """Write a plant's run-time laws into its model, where the callback looks for them."""
    model = plant.model
    table = model.numeric_data
    address_of = {int(model.jnt_dofadr[j]): int(model.jnt_qposadr[j]) for j in range(model.njnt)}
    for e, element in enumerate(plant.elements):
        rows = element.rows
        joints = [(address_of[d], d, *rows[:, d].tolist()) for d in element.joints.tolist()]
        entry: list[float] = [element.address, element.offset, len(joints), element.constants.size]
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
        fill_table(plant, _callback()[1])
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
    callback, _ = _callback()
    with _lock:
        mujoco.set_mjcb_passive(callback.ctypes)
        try:
            yield
        finally:
            mujoco.set_mjcb_passive(None)


def _find_pointer(address: int, target: int, words: int = 60000) -> int:
    memory = np.ctypeslib.as_array((ctypes.c_uint64 * words).from_address(address))
    for i in range(words):
        if memory[i] == target:
            while memory[i + 1] == target:
                i += 1
            return i
    raise NumericsError("This MuJoCo build keeps its arrays where physid cannot find them.")


@lru_cache(maxsize=1)
def _callback() -> tuple[Any, float]:
    marker = 1237
    probe = mujoco.MjModel.from_xml_string(
        "<mujoco><custom><numeric name='n' size='1237' data='0'/></custom><worldbody><body>"
        "<joint name='j' type='slide'/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(probe)
    model_words = np.ctypeslib.as_array((ctypes.c_int64 * 200).from_address(probe._address))
    size_at = int(np.flatnonzero(model_words == marker)[0])
    numbers_at = _find_pointer(probe._address, probe.numeric_data.ctypes.data)
    qpos_at = _find_pointer(data._address, data.qpos.ctypes.data)
    qvel_at = _find_pointer(data._address, data.qvel.ctypes.data)
    force_at = _find_pointer(data._address, data.qfrc_passive.ctypes.data)
    mujoco.mj_step(probe, data)
    data.time = 12345.678
    words = np.ctypeslib.as_array((ctypes.c_double * 60000).from_address(data._address))
    time_at = int(np.flatnonzero(words == data.time)[0])
    _MARK.value = float(np.random.default_rng().uniform(1e9, 1e12))
    add_symbol(_MARK_NAME, ctypes.addressof(_MARK))
    # What the code takes from here, the engine's version and layout, keys the kept code.
    version = mujoco.mj_version()
    width, header, entry = ELEMENT_WIDTH, _HEADER, JOINT_WIDTH

    @kept_c_function(types.void(types.uintp, types.uintp))
    def passive(model_address, data_address):  # type: ignore[no-untyped-def]
        model = carray(pointer_at(np.int64(model_address)), (numbers_at + 1,)).view(np.int64)
        state = carray(pointer_at(np.int64(data_address)), (force_at + time_at,))
        state_words = state.view(np.int64)
        size = model[size_at]
        if size < 2:
            return
        table = carray(pointer_at(model[numbers_at]), (size,))
        if version < 0 or table[size - 2] != own_mark():  # type: ignore[call-arg]
            return
        nv = model[1]
        qpos = carray(pointer_at(state_words[qpos_at]), (model[0],))
        qvel = carray(pointer_at(state_words[qvel_at]), (nv,))
        force = carray(pointer_at(state_words[force_at]), (nv,))
        base = model[numbers_at]
        for e in range(int(table[size - 1])):
            start = size - 2 - width * (e + 1)
            joints = int(table[start + 2])
            x = -table[start + 1]
            v = 0.0
            for j in range(joints):
                at = start + header + entry * j
                x += table[at + 2] * qpos[int(table[at])]
                v += table[at + 3] * qvel[int(table[at + 1])]
            constants = pointer_at(base + 8 * (start + header + entry * joints))
            f = call_law(np.int64(table[start]), x, v, state[time_at], constants)
            for j in range(joints):
                at = start + header + entry * j
                force[int(table[at + 1])] += table[at + 4] * f

    return passive, _MARK.value
