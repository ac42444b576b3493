"""Runs of many cases: the same rows by every kind of workers, whatever is killed in between."""

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import pytest

from optdock.config import load_scenario
from optdock.deadline import TICK, clock_name
from optdock.errors import InvalidFile, InvalidValue, MissingExtra, OptdockError
from optdock.runner import Case, Outcome, OutcomeStore, Workers, run_cases, run_head
from tests.optdock.runner import functions

ROOT = Path(__file__).resolve().parents[3]
COUNT = 30


def cases(count=COUNT, *arguments):
    return (Case(f"case {number}", (number, *arguments)) for number in range(count))


def rows(outcomes):
    """Return what must not depend on the workers."""
    return [(one.key, one.value, one.error) for one in outcomes]


def waited_for(condition):
    """Wait until a condition holds; the time limit of the test applies."""
    while not condition():
        time.sleep(0.02)


def alone(**options):
    return Workers(1, prepare=None, **options)


@pytest.fixture(scope="module")
def pair():
    """Two processes of this machine."""
    with Workers(2, prepare=None, clock="counted") as workers:
        yield workers


class Cluster:
    """A scheduler and workers with two threads each, as processes, which communicate over TCP."""

    def __init__(self, folder):
        known = folder / "scheduler.json"
        self.environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
        }
        self.processes = []
        self.start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", known)
        waited_for(lambda: known.exists() and known.read_text().endswith("}"))
        self.address = json.loads(known.read_text())["address"]

    def start(self, name, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.{name}", *arguments, "--no-dashboard"]
        self.processes.append(subprocess.Popen(command, env=self.environment, stderr=subprocess.DEVNULL))
        return self.processes[-1]

    def add_workers(self, count):
        arguments = (self.address, "--nthreads", "2", "--no-nanny")
        return [self.start("dask_worker", *arguments) for _ in range(count)]

    def workers(self):
        return Workers(scheduler=self.address, prepare=None, clock="counted")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    pytest.importorskip("distributed")
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        made.add_workers(2)
        yield made
    finally:
        for process in made.processes:
            process.kill()
            process.wait()


def test_every_kind_of_workers_yields_the_same_rows(pair, cluster):
    """In the order of the cases, though the first one ends last; a failing case does not stop the others."""
    with alone(clock="counted") as workers:
        expected = rows(run_cases(functions.failing, cases(), workers=workers))
        counted = rows(run_cases(functions.clock_of_case, cases(3), workers=workers))
    assert [key for key, _, _ in expected] == [f"case {number}" for number in range(COUNT)]
    assert expected[:2] == [("case 0", [0, []], ""), ("case 1", None, "ValueError: 1 is not wanted")]
    assert counted == [(f"case {number}", ["counted", 0.0, number], "") for number in range(3)]
    with cluster.workers() as remote:
        for workers in (pair, remote):
            assert rows(run_cases(functions.failing, cases(), workers=workers)) == expected
            assert rows(run_cases(functions.clock_of_case, cases(3), workers=workers)) == counted
            slow = [Case("slow", (3, 0.2)), *cases(5)]
            assert rows(run_cases(functions.squared, slow, workers=workers))[0][0] == "slow"


def test_a_process_computes_one_case_at_a_time(cluster, tmp_path):
    """Also a dask worker with two threads, so that a case has the clock of its process for itself."""
    same = (Case(str(number), (str(tmp_path),)) for number in range(COUNT))
    with cluster.workers() as workers:
        found = [one.value for one in run_cases(functions.overlapping, same, workers=workers)]
    assert found == [False] * COUNT


def test_shared_arguments_are_not_sent_with_every_case(pair, monkeypatch):
    sent, submit = [], pair._executor.submit

    def counted(*arguments):
        sent.append(len(pickle.dumps(arguments)))
        return submit(*arguments)

    monkeypatch.setattr(pair._executor, "submit", counted)
    outcomes = run_cases(functions.restored, cases(3), workers=pair, shared=(bytes(1_000_000),))
    assert [one.value[0] for one in outcomes] == [0, 1, 2]
    assert max(sent) < 10_000


def test_shared_arguments_are_restored_once_per_process(pair, cluster):
    shared = functions.Counted()
    shared.content = bytes(10)
    with cluster.workers() as remote:
        for workers in (pair, remote):
            found = []
            for _ in range(2):  # successive runs with equal arguments
                outcomes = run_cases(functions.restored, cases(), workers=workers, shared=(shared,))
                found = [one.value for one in outcomes]
            assert [number for number, _, _ in found] == list(range(COUNT))
            assert {count for _, _, count in found} == {1}
            assert os.getpid() not in {process for _, process, _ in found}
    with alone() as workers:
        assert [one.value[2] for one in run_cases(functions.restored, cases(2), workers=workers, shared=(shared,))] == [
            0,
            0,
        ]


def test_clock_of_the_cases_is_that_of_the_workers():
    with alone() as workers:
        (cpu,) = run_cases(functions.clock_of_case, cases(1), workers=workers)
    assert cpu.value[0] == "cpu"
    with alone(clock="counted") as workers:
        found = list(run_cases(functions.clock_of_case, [Case("many", (10**6,))], workers=workers))
    assert found[0].value == ["counted", 0.0, round(1.0 / TICK) - 1]  # the construction is a reading
    assert clock_name() == "cpu"  # of these tests


def test_few_cases_are_read_ahead(pair):
    ahead = []

    def watched():
        for number, case in enumerate(cases(60)):
            ahead.append(number - len(done))
            yield case

    done = []
    found = list(run_cases(functions.squared, watched(), workers=pair, progress=done.append))
    assert [one.value["square"] for one in found] == [number**2 for number in range(60)]
    assert max(ahead) == pair.capacity - 1


def test_values_that_cannot_be_stored_are_errors():
    with alone() as workers:
        nan, a_set = run_cases(functions.not_json, cases(2), workers=workers)
    assert nan.error.startswith("ValueError: Out of range float values")
    assert a_set.error == "TypeError: Object of type set is not JSON serializable"


def test_a_case_that_cannot_be_sent_is_an_error(pair):
    first, second = run_cases(functions.squared, [Case("lambda", (lambda: 0,)), Case("2", (2,))], workers=pair)
    assert "lambda" in first.error
    assert second.value["square"] == 4


@pytest.mark.parametrize(("often", "error"), [(1, ""), (2, "BrokenProcessPool: the worker process ended abruptly")])
def test_a_case_that_kills_its_worker_twice_is_an_error(pair, tmp_path, often, error):
    found = list(run_cases(functions.killing, cases(12, str(tmp_path), often), workers=pair))
    assert [one.key for one in found] == [f"case {number}" for number in range(12)]
    assert found[2].error.startswith(error)
    assert found[2].value == (None if error else 2)
    assert [one.value for one in found if one.key != "case 2"] == [0, 1, *range(3, 12)]


def test_a_pool_that_breaks_while_it_starts_a_process_is_replaced(pair, monkeypatch):
    submit, raised = pair._executor.submit, []

    def breaking(*arguments):
        if not raised:
            raised.append(True)
            raise OSError("handle is closed")
        return submit(*arguments)

    monkeypatch.setattr(pair._executor, "submit", breaking)
    found = list(run_cases(functions.squared, cases(5), workers=pair))
    assert [one.value["square"] for one in found] == [0, 1, 4, 9, 16]


def test_a_killed_dask_worker_loses_nothing(cluster):
    (worker,) = cluster.add_workers(1)
    with cluster.workers() as workers:
        workers._client.wait_for_workers(3)
        found = []
        for one in run_cases(functions.process_of_case, cases(60, 0.02), workers=workers):
            found.append(one)
            if len(found) == 10:
                worker.kill()
    assert [one.error for one in found if one.error] == []
    assert [one.value[0] for one in found] == list(range(60))


def test_workers_with_another_version_are_refused(cluster, monkeypatch):
    monkeypatch.setattr("optdock.runner.workers.__version__", "9.9")
    with pytest.raises(InvalidValue, match=r"not all workers have optdock 9\.9: tcp://127\.0\.0\.1:\d+: 0"):
        cluster.workers().__enter__()


def test_a_case_that_kills_dask_workers_is_an_error(cluster, tmp_path):
    """It takes the last two workers, so this is the last test with them."""
    with cluster.workers() as workers:
        case = Case("deadly", (2, str(tmp_path), 99))
        (found,) = run_cases(functions.killing, [case], workers=workers)
    assert found.error.startswith("KilledWorker: ")
    assert len(list(tmp_path.iterdir())) == 2


def test_a_lost_scheduler_ends_the_run(tmp_path):
    """Its futures are cancelled; cases that were not computed must not be stored as failed."""

    class Lost(Workers):
        capacity = 4

        def task(self, function, shared):
            def submit(case):
                future = Future()
                if case.key == "case 1":
                    future.cancel()
                else:
                    future.set_result(Outcome(case.key))
                return future

            return submit

    with stored(tmp_path / "outcomes.jsonl") as store:
        outcomes = run_cases(functions.squared, cases(4), workers=Lost(1), store=store)
        assert next(outcomes).key == "case 0"
        with pytest.raises(OptdockError, match="the same command continues the run"):
            next(outcomes)
    with stored(tmp_path / "outcomes.jsonl") as store:
        assert "case 1" not in store.earlier


def test_counted_plans_on_a_shared_map_do_not_depend_on_workers_or_order(pair):
    """Bit for bit, though the obstacles of the map are cached in the shared problem."""
    problem = load_scenario(ROOT / "examples" / "data" / "bay.yaml").problem
    starts = [Case(f"{x} {yaw}", (x, 1.5, yaw)) for x in (1.2, 2.4, 3.0, 4.0) for yaw in (0.0, 2.5)]
    with alone(clock="counted") as workers:
        forward = rows(run_cases(functions.planned, starts, workers=workers, shared=(problem,)))
    assert {bool(error) for _, _, error in forward} == {True, False}
    backward = run_cases(functions.planned, reversed(starts), workers=pair, shared=(problem,))
    assert rows(backward) == forward[::-1]


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("optdock.runner.workers._ANSWER", 0.2)
    with pytest.raises(InvalidValue, match=r"tcp://127\.0\.0\.1:9: no dask scheduler answers within 0\.2 s"):
        Workers(scheduler="tcp://127.0.0.1:9").__enter__()


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtra, match=r"pip install 'optdock\[cluster\]'"):
        Workers(scheduler="tcp://127.0.0.1:9").__enter__()


@pytest.mark.parametrize("options", [{"count": 0}, {"count": 2, "scheduler": "tcp://127.0.0.1:9"}])
def test_contradicting_workers_are_rejected(options):
    with pytest.raises(InvalidValue, match="workers: count"):
        Workers(**options)


def test_workers_must_be_entered_and_keys_be_unique():
    with pytest.raises(InvalidValue, match="as a context"):
        next(run_cases(functions.squared, cases(1), workers=alone()))
    with alone() as workers, pytest.raises(InvalidValue, match="key 'case 0' occurs twice"):
        list(run_cases(functions.squared, [*cases(2), *cases(1)], workers=workers))


def stored(path, task="squares", **options):
    return OutcomeStore(path, run_head(task, alone(**options), seed=1))


def lines_of(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_finished_cases_are_not_computed_again(tmp_path):
    path, done = tmp_path / "new" / "outcomes.jsonl", []
    with alone() as workers, stored(path) as store:
        first = list(run_cases(functions.failing, cases(4), workers=workers, store=store))
    with alone() as workers, stored(path) as store:
        assert set(store.earlier) == {f"case {number}" for number in range(4)}
        again = list(run_cases(functions.failing, cases(6), workers=workers, store=store, progress=done.append))
    assert again[:4] == first  # also the CPU time
    assert done == [f"case {number}" for number in range(6)]
    head, *written = lines_of(path)
    assert head["format"] == "optdock-outcomes/1"
    assert head["versions"].keys() == {"optdock", "python", "numpy", "scipy", "casadi", "ruckig"}
    assert [row.get("key", "head") for row in written] == [*(f"case {k}" for k in range(4)), "head", "case 4", "case 5"]


@pytest.mark.parametrize("torn", [b'{"key": "case 9", "va', b"\xff", b'{"format": "optdock'])
def test_a_torn_last_line_is_cut_off(tmp_path, torn):
    path = tmp_path / "outcomes.jsonl"
    with alone() as workers, stored(path) as store:
        list(run_cases(functions.squared, cases(2), workers=workers, store=store))
    whole = path.read_bytes()
    path.write_bytes(whole + torn)
    with stored(path) as store:
        assert len(store.earlier) == 2
    assert path.read_bytes().startswith(whole + b'{"format":')
    assert len(lines_of(path)) == 4
    path.write_bytes(torn)  # not even the first head
    with stored(path) as store:
        assert store.earlier == {}
    assert len(lines_of(path)) == 1


@pytest.mark.parametrize("changed", [{"task": "cubes"}, {"clock": "wall"}])
def test_outcomes_of_another_task_are_refused(tmp_path, changed):
    path = tmp_path / "outcomes.jsonl"
    stored(path).__exit__()
    before = path.read_bytes()
    with pytest.raises(InvalidFile, match=r"outcomes\.jsonl:1: digest: .* choose another folder or delete the file"):
        stored(path, **changed)
    assert path.read_bytes() == before


@pytest.mark.parametrize("line", [b"", b"[]", b"{}", b'{"key": "a", "value": NaN}', b'{"key": "a", "colour": 1}'])
def test_other_files_are_refused(tmp_path, line):
    path = tmp_path / "outcomes.jsonl"
    path.write_bytes(line + b"\n")
    with pytest.raises(InvalidFile, match=r"outcomes\.jsonl:1: is not a line"):
        stored(path)
    path.unlink()
    stored(path).__exit__()
    path.write_bytes(path.read_bytes() + line + b"\n")
    with pytest.raises(InvalidFile, match=r"outcomes\.jsonl:2: is not a line"):
        stored(path)


def test_a_file_has_one_writer(tmp_path):
    with stored(tmp_path / "outcomes.jsonl"), pytest.raises(InvalidFile, match="another run is writing"):
        stored(tmp_path / "outcomes.jsonl")


def test_an_unwritable_file_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InvalidFile, match="cannot be written"):
        stored(tmp_path / "file" / "outcomes.jsonl")


def test_numbers_survive_the_file_bit_by_bit(tmp_path):
    path, values = tmp_path / "outcomes.jsonl", [0.1 + 0.2, 5e-324, -0.0, 1e308, 2**60]
    with stored(path) as store:
        store.append(Outcome("a", values, cpu_seconds=0.1))
    with stored(path) as store:
        assert repr(store.earlier["a"]) == repr(Outcome("a", values, cpu_seconds=0.1))


RUN = """
import signal
import sys
from optdock.runner import Case, OutcomeStore, Workers, run_cases, run_head
from tests.optdock.runner.functions import process_of_case
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored if the tests run in the background of a shell
    with Workers(2, prepare=None) as workers, OutcomeStore(sys.argv[1], run_head("killed", workers, 1)) as store:
        cases = [Case(f"case {number}", (number, 0.05)) for number in range(40)]
        list(run_cases(process_of_case, cases, workers=workers, store=store))
"""


def test_a_script_without_main_guard_is_told_so(tmp_path):
    script = tmp_path / "run.py"
    script.write_text("from optdock.runner import Workers\nWorkers(2).__enter__()\n")
    command, environment = [sys.executable, script], os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, check=False, env=environment, capture_output=True, text=True)
    assert run.returncode == 1
    assert "no process starts; in a script, call the run below \"if __name__ == '__main__':\"" in run.stderr


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_is_resumed(tmp_path, sent):
    """Nothing is lost and nothing computed twice; its workers end with it. SIGTERM has no handler: as SIGKILL."""
    path, script = tmp_path / "outcomes.jsonl", tmp_path / "run.py"
    script.write_text(RUN)
    command = [sys.executable, script, path]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    run = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    waited_for(lambda: path.exists() and path.read_bytes().count(b"\n") > 5)
    run.send_signal(sent)
    assert run.wait() != 0
    before = path.read_bytes()
    path.write_bytes(before + b'{"key":"case 3')
    finished = {row["key"]: row["value"] for row in map(json.loads, before.splitlines()[1:])}
    assert 5 <= len(finished) < 40
    waited_for(lambda: not any(is_running(pid) for _, pid in finished.values()))
    with Workers(1, prepare=None) as workers, OutcomeStore(path, run_head("killed", workers, 1)) as store:
        found = list(run_cases(functions.process_of_case, cases(40, 0.0), workers=workers, store=store))
    assert [one.value[0] for one in found] == list(range(40))
    assert {one.key: one.value for one in found if one.value[1] != os.getpid()} == finished
    keys = [row["key"] for row in lines_of(path) if "key" in row]
    assert len(keys) == len(set(keys)) == 40
