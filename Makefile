# make demo: the main job, end to end.  make test: what CI runs.  Both make .venv first.
# make test PYTHON=python3.13 uses another Python (and the jax that goes with it).

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
READY := $(VENV)/.ready-$(VERSION)

.PHONY: demo test lint lock notebook bench bench-peers peers parity interop interop-gymnax lunar-lander clean

demo: $(READY)
	$(BIN)/jaxq sweep article-q --gamma 0.9 0.95 0.99 --seeds 100 --out runs/demo-q-sweep --overwrite
	$(BIN)/jaxq sweep article-dqn --learning-rate 1e-4 3e-4 --seeds 4 --out runs/demo-dqn-sweep --overwrite
	$(BIN)/jaxq train article-q --out runs/demo-q --overwrite

test: lint
	$(BIN)/pytest -n 2 --dist worksteal

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "jaxq needs Python 3.11 or later")'
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

# Versions for every supported Python in one file, with hashes and without an address.
lock:
	$(PYTHON) -m pip install --quiet uv
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	  --no-emit-index-url --no-emit-find-links --extra test pyproject.toml -o requirements.lock

notebook: $(READY)
	$(BIN)/python notebooks/execute.py

# Our suites beside the limits of this machine; tables, pictures and ratios go to docs/benchmarks.md.
bench: $(READY)
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.page

# The same beside the peers.
bench-peers: $(READY)
	-$(PYTHON) benchmarks/peers/install.py
	$(BIN)/python -m benchmarks --peers
	$(BIN)/python -m benchmarks.page

# What the benchmarks are compared with; says what cannot be installed, and leaves what is there already.
peers:
	$(PYTHON) benchmarks/peers/install.py

# Our rules beside rlax's, in an environment of its own: rlax asks for a nightly build, so it never is a dependency.
parity:
	$(PYTHON) benchmarks/peers/install.py .venv-peers-rlax
	PYTHONPATH=tests .venv-peers-rlax/bin/python -m reference.rlax_parity

# stable-baselines3's DQN on our CartPole as a Gymnasium environment, in an environment of its own.
interop:
	$(PYTHON) benchmarks/peers/install.py .venv-peers
	PYTHONPATH=. .venv-peers/bin/python tests/reference/sb3_drives.py

# gymnax's CartPole beside ours, and our DQN in gymnax's environments; gymnax excludes Gymnasium 1.4.
interop-gymnax:
	$(PYTHON) benchmarks/peers/install.py .venv-peers-gymnax
	PYTHONPATH=. .venv-peers-gymnax/bin/python tests/reference/gymnax_wrapped.py

# Our DQN in Gymnasium's LunarLander-v3 by the host loop: minutes.
lunar-lander:
	$(PYTHON) benchmarks/peers/install.py .venv-peers-box2d
	PYTHONPATH=. .venv-peers-box2d/bin/python -m benchmarks.lunar_lander

clean:
	rm -rf $(VENV) .venv-peers* .pytest_cache .mypy_cache .ruff_cache .hypothesis
