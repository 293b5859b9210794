"""A record: what was measured in one run, on a uniform time grid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from physid.errors import RecordError, available
from physid.record import clock, resampling

Array = npt.NDArray[np.float64]


def _frozen(values: npt.ArrayLike) -> Array:
    copy = np.array(values, dtype=np.float64)
    copy.setflags(write=False)
    return copy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """The samples of a record as its clock wrote them, before resampling.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times, s.
    values : ndarray, shape (n, c)
        One column per column of the record.
    """

    time: Array
    values: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _frozen(self.time))
        object.__setattr__(self, "values", _frozen(self.values))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """One measured run.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Uniform times, starting where the file started, s. n is at least 2.
    columns : tuple of str
        A name per column of `values`, each once.
    values : ndarray, shape (n, c)
        Finite values, SI units: outputs at that instant, inputs from that instant on. Read-only.
    path : str
        Display name: the file the record was read from, or a description.
    notes : tuple of str
        What was done to the data on reading, one sentence each.
    raw : Samples, optional
        The samples before resampling, where the times had jitter; `hold` needs them.
    ignored : tuple of str
        Names of the file's columns that were not wanted.

    Raises
    ------
    RecordError
        If shapes disagree, a value is not finite, the times are not uniform, or a name is blank,
        repeated or ``time``. `uniform` makes a record from times that are only nearly uniform.
    """

    time: Array = field(repr=False)
    columns: tuple[str, ...]
    values: Array = field(repr=False)
    path: str = "record"
    notes: tuple[str, ...] = ()
    raw: Samples | None = field(default=None, repr=False)
    ignored: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _frozen(self.time))
        object.__setattr__(self, "values", _frozen(self.values))
        object.__setattr__(self, "columns", tuple(self.columns))
        object.__setattr__(self, "notes", tuple(self.notes))
        check_names(self.columns, self.path)
        check_shapes(self.time, self.columns, self.values, self.path)
        if not (np.isfinite(self.time).all() and np.isfinite(self.values).all()):
            raise RecordError(
                f"Every time and value of {self.path} must be finite, but some are NaN or infinite."
            )
        if not (np.diff(self.time) > 0.0).all() or not clock.is_exact(self.time):
            raise RecordError(
                f"The times of {self.path} are not uniform, but those of a Record must be: make it "
                "with `uniform`."
            )

    @property
    def dt(self) -> float:
        """Sampling step, s."""
        return self.duration / (self.samples - 1)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def samples(self) -> int:
        """Number of rows n."""
        return int(self.time.size)

    def column(self, name: str) -> Array:
        """One column by its name.

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        RecordError
            If there is no such column; the sentence lists the ones there are.
        """
        return self.values[:, self._index(name)]

    def select(self, names: Iterable[str]) -> Array:
        """Several columns, in the order asked for.

        Returns
        -------
        ndarray, shape (n, k)

        Raises
        ------
        RecordError
            If a name is not a column.
        """
        return self.values[:, [self._index(name) for name in names]]

    def rename(self, mapping: Mapping[str, str]) -> Record:
        """Call columns otherwise.

        Parameters
        ----------
        mapping : mapping of str to str
            Column name to new name; what it does not name keeps its name.

        Raises
        ------
        RecordError
            If a column does not exist, or two columns would share a name.
        """
        return replace(self, columns=renamed(self.columns, mapping, self.path))

    def slice(self, start: int, stop: int | None = None) -> Record:
        """Cut out the samples from `start` up to, not including, `stop`, as Python counts.

        Raises
        ------
        RecordError
            If fewer than two samples remain.
        """
        part = slice(start, stop)
        return replace(self, time=self.time[part], values=self.values[part])

    def hold(self, names: Collection[str]) -> Record:
        """Resample some columns as inputs held between samples.

        A record whose times had jitter was resampled by interpolation, which is right for outputs.
        Columns that turn out to be inputs are resampled again from the original samples. A record
        that was not resampled is returned as it is.

        Parameters
        ----------
        names : collection of str
            The held columns; names that are not columns are passed over.
        """
        held = [index for index, name in enumerate(self.columns) if name in names]
        if self.raw is None or not held:
            return self
        values = self.values.copy()
        values[:, held] = resampling.hold(self.time, self.raw.time, self.raw.values[:, held])
        return replace(self, values=values)

    def _index(self, name: str) -> int:
        if name not in self.columns:
            raise RecordError(
                f"Column '{name}' does not exist in {self.path}. {available(self.columns)}"
            )
        return self.columns.index(name)


def uniform(
    time: npt.ArrayLike,
    values: npt.ArrayLike,
    names: Sequence[str],
    path: str = "record",
    *,
    held: Collection[str] = (),
    rows: Sequence[int] | npt.NDArray[np.int64] | None = None,
    notes: Iterable[str] = (),
) -> Record:
    """Make a record from measured times, checked and brought onto a uniform grid.

    Times already uniform are kept bit for bit. Times off the grid by clock rounding (under 1e-3 of
    a step, or under half the last digit written) are replaced by the grid from the first to the
    last time. Times with more jitter, while every step is within 50 % of the median one, are
    resampled on that grid with a note: by a cubic spline, held columns by the mean of the held
    value.

    Parameters
    ----------
    time : array_like, shape (n,)
        Measured times, s.
    values : array_like, shape (n, c)
        Measured values, SI units.
    names : sequence of str
        Column names.
    path : str
        Display name for sentences.
    held : collection of str
        Columns held from one sample to the next (inputs).
    rows : sequence of int, optional
        Row of each sample in its file; by default 2, 3, ... as below a header.
    notes : iterable of str
        What was done to the data before.

    Raises
    ------
    RecordError
        If there are fewer than 2 rows, a time or value is not finite, times repeat or go backwards,
        or there is a gap; the sentence names the row.
    """
    times, data = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
    check_names(tuple(names), path)
    check_shapes(times, names, data, path)
    number = np.arange(2, times.size + 2) if rows is None else np.asarray(rows, dtype=np.int64)
    where = clock.Rows(path=path, number=number)
    _check_finite(times, data, names, where)
    clock.check_steps_forward(times, where)
    notes = tuple(notes)
    if clock.is_exact(times):
        return Record(time=times, columns=tuple(names), values=data, path=path, notes=notes)
    grid = clock.even_grid(times)
    if clock.is_rounded(times):
        return Record(time=grid, columns=tuple(names), values=data, path=path, notes=notes)
    clock.check_steps_even(times, where)
    smooth = Record(
        time=grid,
        columns=tuple(names),
        values=resampling.smooth(grid, times, data),
        path=path,
        notes=(*notes, _jitter_note(times, grid, path)),
        raw=Samples(time=times, values=data),
    )
    return smooth.hold(held)


def renamed(columns: Sequence[str], mapping: Mapping[str, str], path: str) -> tuple[str, ...]:
    """Give columns their new names.

    Raises
    ------
    RecordError
        If the mapping names a column that does not exist, or gives two columns one name.
    """
    for old in mapping:
        if old not in columns:
            raise RecordError(
                f"Column '{old}' to be renamed does not exist in {path}. {available(columns)}"
            )
    names = tuple(mapping.get(name, name) for name in columns)
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        alike = ", ".join(
            f"'{old}'" for old, new in zip(columns, names, strict=True) if new == twice[0]
        )
        raise RecordError(
            f"The columns {alike} of {path} would all be called '{twice[0]}', but each name may "
            "stand once: rename one of them otherwise."
        )
    return names


def check_names(names: Sequence[str], path: str) -> None:
    """Refuse column names that are blank, padded, repeated or ``time``.

    Raises
    ------
    RecordError
        Naming the first such column.
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise RecordError(
                f"The column name '{name}' stands {count} times in {path}, but each may stand "
                "once: remove or rename the repeated column."
            )
        if name == "time" or not name or name != name.strip() or not name.isprintable():
            raise RecordError(
                f"A column of {path} cannot be called {name!r}: a name is printable text without "
                "blanks around it, other than 'time'."
            )


def check_shapes(time: Array, names: Sequence[str], values: Array, path: str) -> None:
    """Refuse times, names and values whose shapes do not belong together.

    Raises
    ------
    RecordError
        Naming the shapes.
    """
    if time.ndim != 1 or values.shape != (time.size, len(names)):
        raise RecordError(
            f"The shapes in {path} do not agree: time {time.shape} and values {values.shape} with "
            f"{len(names)} column names, where (n,) and (n, names) are needed."
        )
    if time.size < 2:
        raise RecordError(
            f"{path} has {time.size} row{'' if time.size == 1 else 's'} of samples, but a record "
            "needs at least 2: give a longer one."
        )


def _check_finite(time: Array, values: Array, names: Sequence[str], rows: clock.Rows) -> None:
    table = np.column_stack([time, values])
    bad = np.argwhere(~np.isfinite(table))
    if bad.size == 0:
        return
    sample, index = (int(i) for i in bad[0])
    value = table[sample, index]
    given = "is empty or not a number (NaN)" if np.isnan(value) else f"is infinite ({value:g})"
    raise RecordError(
        f"The value of column '{['time', *names][index]}' at {rows.at(sample)} {given}, but every "
        "value must be a finite number: correct or remove that row."
    )


def _jitter_note(time: Array, grid: Array, path: str) -> str:
    off, step = clock.distance(time, grid), grid[1] - grid[0]
    return (
        f"The times of {path} lie up to {clock.seconds(float(f'{off:.3g}'))} "
        f"({100 * off / step:.2g} % of a step) off a uniform clock; the record was resampled every "
        f"{clock.seconds(float(f'{step:.9g}'))}."
    )
