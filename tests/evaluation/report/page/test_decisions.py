import pytest

from activestructure_gym.evaluation.report.page.decisions import phase_strip, run_trace, trace_table


def test_a_row_per_decision(make_run):
    run = make_run()
    table = trace_table(run)
    headings = [heading.text for heading in table.headings]
    assert len(table.rows) == 6 and "phase" not in headings and "runner-up" not in headings
    by_name = [dict(zip(headings, (cell.text for cell in row))) for row in table.rows]
    assert [row["frames"] for row in by_name] == ["10", "20", "30", "40", "50", "60"]
    assert [row["s"] for row in by_name] == ["2.00", "2.00", "2.00", "n/a", "n/a", "n/a"]
    assert by_name[1]["pixel"] == "0.250" and by_name[0]["planes"] == "5"
    assert phase_strip(run) is None
    assert "6 decisions" in run_trace(run)[0]


def test_phases_and_why_they_changed(make_run):
    run = make_run(policy="<b>")
    for k, step in enumerate(run.steps):
        phase = "I scaffold" if k < 2 else "II objects"
        chosen = {"pixel": 0.5, "total": 0.4}
        step["trace"] = {"phase": phase, "changed": "pool & empty" if k == 2 else None, "chosen": chosen,
                         "runner_up": {"row": 3, "total": 0.3}}  # fmt: skip
    table = trace_table(run)
    headings = [heading.text for heading in table.headings]
    row = dict(zip(headings, table.rows[2]))
    assert row["phase"].text == "II objects ←" and row["phase"].note == "pool & empty"
    assert row["total"].text == "0.400" and row["runner-up"].text == "0.300"
    summary, text = run_trace(run)
    assert "<b>, seed 0" in summary
    assert "pool &amp; empty" in text and "<b>," not in text
    assert text.count('class="phase f0"') == 1 and text.count('class="phase f1"') == 1


@pytest.mark.slow
def test_of_very_many_decisions_an_even_choice_is_listed(make_run):
    run = make_run()
    run.steps[:] = [{**run.steps[k % 6], "decision": k, "frames": k + 2} for k in range(70_000)]
    table = trace_table(run)
    assert len(table.rows) == 2001 and table.title.endswith("(2,001 of 70,000; all are in steps.jsonl)")
    assert [table.rows[k][0].text for k in (0, 1, -1)] == ["0", "35", "69,999"]
    summary, text = run_trace(run)
    assert "70000 decisions" in summary and len(text) < 3_000_000
