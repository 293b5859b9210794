"""Compiled code is kept where it can be, and does without where it cannot."""

from numba.core import caching

from physid.plant.callback import _callbacks, own_mark
from physid.plant.compiling import kept, kept_c_function
from physid.plant.law import LAW_SIGNATURE, force_law


def test_without_a_writable_folder_functions_are_compiled_anew(monkeypatch):
    for kind in (caching.CompileResultCacheImpl,):
        monkeypatch.setattr(kind, "_locator_classes", [])

    @kept(nogil=True)
    def twice(x):
        return 2.0 * x

    @kept_c_function(LAW_SIGNATURE)
    def law(x, v, t, p):
        return x + p[0]

    assert twice(1.5) == 3.0
    assert law.address


def test_plain_decoration_works_as_well():
    @kept
    def half(x):
        return 0.5 * x

    assert half(3.0) == 1.5


def test_kept_code_reads_the_mark_of_its_own_process():
    mark = _callbacks().mark

    @kept
    def read():
        return own_mark()

    assert read() == mark
    assert 1e9 < mark < 1e12


def test_a_law_is_compiled_once_and_only_when_its_address_is_asked_for():
    law = force_law(lambda x, v, t, p: -p[0] * x)
    assert "compiled" not in vars(law)
    first = law.address
    assert first
    assert law.address == first
