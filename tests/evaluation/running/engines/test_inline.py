from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.engines import ENGINES, Limits, Outcome, inline
from activestructure_gym.evaluation.running.engines.base import LOGS


class Silent:
    def progress(self, job, progress):
        pass

    def begin(self, jobs, finished):
        pass

    def on_retry(self, job, error):
        pass

    def ended(self, outcome):
        pass


def test_a_job_that_fails_is_reported_with_its_traceback_and_the_others_go_on(tmp_path, monkeypatch):
    def run_job(job, directory, progress):
        if job.policy == "bad":
            raise ZeroDivisionError("the policy divided by zero")
        if job.policy == "exits":
            raise SystemExit(0)

    monkeypatch.setattr(inline, "run_job", run_job)
    jobs = [Job("box", "bad", 0), Job("box", "exits", 0), Job("box", "good", 0)]
    outcomes = ENGINES.get("inline").run(jobs, tmp_path, Silent(), Limits())
    assert outcomes == [
        Outcome(jobs[0], "ZeroDivisionError: the policy divided by zero"),
        Outcome(jobs[1], "the policy ended the process (exit code 0) before the run was done"),
        Outcome(jobs[2]),
    ]
    (log,) = (tmp_path / LOGS).glob("*bad*")
    assert "Traceback" in log.read_text() and "ZeroDivisionError" in log.read_text()
