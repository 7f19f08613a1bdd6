"""What every test shares: the command line's XLA settings, JAX's check that no key is used twice, and no cache of
compiled programs unless a test asks for one.
"""

import importlib.util
import os
from pathlib import Path

import pytest

from jaxq import cpu

cpu.tune()
os.environ["JAXQ_CACHE_DIR"] = ""

import jax  # noqa: E402 (after the settings)

from jaxq import executables  # noqa: E402
from jaxq.compile_cache import CompileCache  # noqa: E402

jax.config.update("jax_debug_key_reuse", True)

REFERENCE = Path(__file__).parent / "reference"


#: Bytes that a process may have grown to before it forgets what it compiled: thousands of programs are gigabytes.
MUCH = 2 << 30


@pytest.fixture(scope="module", autouse=True)
def _compiled_programs_are_not_kept_for_ever():
    yield
    resident = Path("/proc/self/statm")
    if resident.exists() and int(resident.read_text().split()[1]) * os.sysconf("SC_PAGESIZE") > MUCH:
        jax.clear_caches()


@pytest.fixture(scope="module")
def programs_are_compiled_once(tmp_path_factory):
    """A cache of compiled programs that all who ask for it share, in every worker, whether they call the command line,
    the library or another process: nothing depends on it but time.
    """
    own = tmp_path_factory.getbasetemp()
    place = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "programs"
    build = executables.build

    def shared(program, example, impl, cache=None):
        return build(program, example, impl, CompileCache(place) if cache is None else cache)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAXQ_CACHE_DIR", str(place))
        patch.setattr(executables, "build", shared)
        yield


@pytest.fixture(scope="session")
def tutorial():
    """The tutorial's table agent in plain NumPy over Gymnasium."""
    spec = importlib.util.spec_from_file_location("tutorial_tabular", REFERENCE / "tutorial_tabular.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
