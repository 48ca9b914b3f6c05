# The long tests and measurements that CONTRIBUTING.md names; the Makefile includes this file. Each takes minutes to hours.

# Where programs find what pytest finds by `pythonpath` in pyproject.toml.
TESTS_PATH := tests/support:tests/support/programs:tests/assurance:docs/evaluation:tests/cases/compose:images/rorg:.ci:.:clients/python

.PHONY: engines pythons fuzz fuzz-guided properties proof proof-docker worlds defects mutants soak soak-random ros2 corpus bench evaluation contention recorded programs deployment packages arm vm machines

# Other engines: each cell of docs/reference/engines.md, and a long day on each. Writes the cells down.
engines: $(VENV)/test-installed
	RORG_TEST_RECORD=1 RORG_TEST_CYCLES=200 RORG_TEST_UPDATES=20 .ci/engines docker docker26 docker26-containerd podman podman-rootless
	$(BIN)/python docs/reference/generate.py

# More of the tests that need no Docker, on each Python after 3.11 that this machine has: some minutes each.
pythons:
	.ci/versions all

# All cases of tests/support/fuzzing.py, of which `make test` tries a few: half an hour. FUZZ=0.1 for a tenth of them.
fuzz: $(VENV)/test-installed
	FUZZ=$(or $(FUZZ),1) timeout 7200 $(BIN)/pytest -s -m fuzz tests/hostile tests/clients/test_cpp_answers.py $(ARGS)

# Inputs are changed towards code that none has reached (atheris, in a venv of its own; Python 3.11): MINUTES for all
# targets together, or ARGS="compose journal" for some. What is found is kept in tests/cases/fuzz, which `make test` tries.
fuzz-guided: $(VENV)/fuzz-guided/installed
	$(VENV)/fuzz-guided/bin/python tests/assurance/guided/guided_fuzzing.py $(or $(MINUTES),20) $(ARGS)

# It sees what $(VENV) has, by a file that names its packages.
$(VENV)/fuzz-guided/installed: $(VENV)/test-installed
	@$(BIN)/python -m venv --without-pip $(VENV)/fuzz-guided
	@$(BIN)/python tests/assurance/guided/guided_fuzzing.py --venv $(VENV)/fuzz-guided
	@$(BIN)/python -m pip --python $(VENV)/fuzz-guided install --quiet --disable-pip-version-check 'atheris>=2.3,<3'
	@touch $@

# Each property of the planner with many random examples, of which `make test` tries a few: EXAMPLES=20000 takes 30 to 45
# minutes for each. A failure names its seed, and RORG_TEST_SEED=N draws the same examples again.
properties: $(VENV)/test-installed
	RORG_TEST_EXAMPLES=$(or $(EXAMPLES),1000) $(BIN)/pytest -s tests/unit/core/test_properties.py $(ARGS)

# rorg is killed at every effect it has (each write, call of the engine, commit, answer to a client), in every scenario of
# tests/assurance/proof, on an engine that outlives it; at some of them the rorg that follows is killed too. Then defects
# are planted, which must be found. One to two hours.
# RORG_PROOF_EVERY=10 for every tenth point; RORG_PROOF_SCENARIO=down RORG_PROOF_POINT=31:power repeats one case;
# RORG_PROOF_ORDER=1 for the other outcomes of a loss of power alone.
proof: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m proof.play $(ARGS)
	RORG_PROOF_TWICE=1 RORG_PROOF_EVERY=$(or $(RORG_PROOF_EVERY),8) PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m proof.play $(ARGS)
	RORG_PROOF_ORDER=1 RORG_PROOF_EVERY=$(or $(RORG_PROOF_EVERY),8) PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m proof.play $(ARGS)
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m proof.defects

# The same on a private Docker engine, as root: RORG_PROOF_MOST points of each scenario, by default 45. An hour.
proof-docker: $(VENV)/test-installed
	RORG_PROOF_MOST=$(or $(RORG_PROOF_MOST),45) PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m proof.docker_world $(ARGS)

# All worlds within the bound of assurance/bounded/bounds.py, of which `make test` tries a slice, and WALKS random walks of
# some 40 steps: half an hour or more. ARGS='-k walks' for walks alone; RORG_TEST_WALKS_SEED=N draws the same ones again.
worlds: $(VENV)/test-installed
	RORG_TEST_WORLDS=all RORG_TEST_WALKS=$(or $(WALKS),2000) $(BIN)/pytest -s tests/assurance/bounded/test_bounded_worlds.py tests/assurance/bounded/test_walks.py $(ARGS)

# All defects of assurance/bounded/defects.py, planted one by one in a copy of rorg; `make test` tries four: some minutes.
defects: $(VENV)/test-installed
	RORG_TEST_DEFECTS=all $(BIN)/pytest tests/assurance/bounded/test_planted_defects.py $(ARGS)

# Small changes of rorg/core, one by one. It fails unless tests find 95 of 100; they do not yet. Two hours or more.
# MUTANTS_EVERY=48 takes every 48th, in some minutes; MUTANTS_FILE=gates.py one file; ARGS=gates.py:54.1 one again.
mutants: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m mutants.hunt $(ARGS)

# ROS 2: all its tests, a thousand requests and releases through its node, five minutes of kills, and what pausing does to
# peers (docs/how-to/ros2.md).
ros2: $(VENV)/test-installed
	RORG_TEST_ROS_CYCLES=$(or $(CYCLES),1000) RORG_TEST_ROS_MINUTES=$(or $(MINUTES),5) $(BIN)/pytest -s tests/ros/*_ros2*.py tests/bench/test_ros2_pausing.py -o norecursedirs=x $(ARGS)

# Steady work on a robot of twenty services for MINUTES: how memory, descriptors and threads change over its second
# half, and whether what runs is what is asked for. Every few minutes the engine is restarted, or the disk of the state
# directory is full for a while. `make test` does the same for some seconds, without faults.
soak: $(VENV)/test-installed
	SOAK_MINUTES=$(or $(MINUTES),20) $(BIN)/pytest -s tests/docker/test_soak.py $(ARGS)

# Random requests, edits, kills, freezes and acts by hand on a robot of 27 services on a private Docker engine, as root:
# do services overlap that must not, is anything called ready that does not run, is anything lost that rorg acknowledged,
# and is the history right? By the events of the engine, for MINUTES from SEED.
soak-random: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m soak_random.run $(or $(MINUTES),40) $(or $(SEED),1) $(ARGS)

# What becomes of each project in tests/cases/corpus when it is imported, and whether Compose, if it is installed, reads
# it as rorg does.
corpus: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python tests/support/corpus.py

# The page of `rorg ui` is measured for half a minute; PAGE_MINUTES=10 for how its memory grows.
bench: $(VENV)/test-installed
	$(BIN)/pytest tests/bench -s -o norecursedirs=x $(ARGS)

# docs/evaluation: figures, plots, and the tables of its page. Some minutes.
evaluation: $(VENV)/test-installed
	$(BIN)/python docs/evaluation/evaluate.py

# How responsive a robot is on a machine with too little CPU, in five ways: docs/evaluation/contention.json, for which
# `make evaluation` draws tables. As root, on a machine that does nothing else, half an hour for each demand. COMPOSE
# names a binary of Docker Compose 2. ARGS="--rounds 1 --seconds 10 --save /tmp/try.json --anyway" tries it in minutes.
contention: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python docs/evaluation/contention.py $(ARGS)

# Three robots run on a private Docker engine, and what was recorded is simulated: how far is the simulator off? A quarter
# of an hour, as root, on a machine that does nothing else; any other is refused. ARGS="--anyway FILE" to try it anyway.
recorded: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python docs/evaluation/recorded.py $(ARGS)
	$(if $(findstring --anyway,$(ARGS)),,$(BIN)/python docs/evaluation/evaluate.py --pages)

# Real programs on Docker, measured: writes docs/evaluation/programs.json. As root, on a machine that does nothing else:
# ten minutes, and more the first time. ARGS="--anyway --save /tmp/try.json" to try it on a busy one.
programs: $(VENV)/test-installed
	$(BIN)/python docs/evaluation/programs.py $(ARGS)

# docs/evaluation/deployment.md: a week of the tour guide with 197 updates and as many faults as a robot meets, on a
# private Docker engine, as root. MINUTES=3 plays its first three of 40 minutes; SEED=2 another week.
deployment: $(VENV)/test-installed
	PYTHONPATH=$(TESTS_PATH) $(BIN)/python -m deployment.play $(or $(SEED),1) $(or $(MINUTES),40) $(ARGS)

# Whether the packages for amd64 and arm64 are what they should be, and install on a bare Debian. As root.
packages: $(VENV)/test-installed
	RORG_TEST_PACKAGES=1 $(BIN)/pytest tests/project/test_deb.py

# The core's tests, and the package, on a Debian for arm64 that qemu emulates: a quarter of an hour, more the first time.
# As root. ARGS=tests/unit/core/test_planner_cases.py for some tests only.
arm: $(VENV)/test-installed
	$(BIN)/python .ci/arm $(ARGS)

# rorg in a whole machine that qemu emulates: systemd, control groups v2, the package, a reboot, power cuts. As root.
# Slow, since all is emulated. CUTS=50 for more power cuts than three; ARGS="-k cut" for them alone.
vm: $(VENV)/test-installed
	CUTS=$(or $(CUTS),3) timeout 14400 $(BIN)/pytest tests/assurance/vm -s -m "not docker" -o norecursedirs=x $(ARGS)

# Several computers: the rules of docs/explanation/machines.md over many random schedules (SCHEDULES), and three Docker
# engines in networks of their own: with an rorg each, whose links are cut; and as one Swarm, whose nodes are killed.
# Takes 1 to 2 hours with 100,000 schedules on two cores.
machines: $(VENV)/test-installed
	$(BIN)/pytest -s tests/assurance/links -o norecursedirs=x $(ARGS)
	RORG_TEST_SCHEDULES=$(or $(SCHEDULES),100000) $(BIN)/python tests/support/machines_world.py
