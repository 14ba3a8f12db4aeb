from autolights.evaluate import evaluate, table


def test_the_tables_hold_our_rows_beside_the_paper_s(town) -> None:
    text = table(evaluate([(town.run_dir, town.drive_dir)], town.signals))
    od = next(line for line in text.splitlines() if line.startswith("│ OD "))
    cells = [cell.strip() for cell in od.strip("│").split("│")]
    assert cells[1:3] == ["40.0", "1.20"]
    assert cells[4:] == ["109", "1.19", "92.8"]
    assert "false tracks" in text
