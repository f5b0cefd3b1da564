from pipeline.report.tables.markdown import table


def test_a_table_is_one_line_a_row() -> None:
    assert table(["a", "b"], [["1", ""], ["x", "2"]]) == ["| a | b |", "| --- | --- |", "| 1 |  |", "| x | 2 |"]
