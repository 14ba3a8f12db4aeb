import io

from rich.console import Console

from autolights.evaluate import ablation_table, detail_table, evaluate


def test_tables_hold_our_rows_beside_the_paper_s(town) -> None:
    evaluation = evaluate([(town.run_dir, town.drive_dir)], town.signals)
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(ablation_table(evaluation))
    console.print(detail_table(evaluation))
    text = console.export_text()
    od = next(line for line in text.splitlines() if line.startswith("│ OD "))
    assert [cell.strip() for cell in od.strip("│").split("│")][1:3] == ["40.0", "1.20"]
    assert "109" in od
    assert "false tracks" in text
