"""Tables of mistakes as text: each row has a line with the input, and the expected message indented below it."""


def cases(table: str) -> list[tuple[str, str]]:
    """What is given and what is said, row by row.

    In what is given, ↵ ends a line; after one at the end, the next line goes on. What is said may have several lines.
    There … stands for anything between two parts (`is_said`).
    """
    rows: list[tuple[str, str]] = []
    for line in table.strip("\n").splitlines():
        if line.startswith("    "):
            given, said = rows[-1]
            rows[-1] = given, f"{said} {line.strip()}".strip()
        elif rows and rows[-1][0].endswith("\n") and not rows[-1][1]:
            rows[-1] = rows[-1][0] + line.replace("↵", "\n"), ""
        else:
            rows.append((line.replace("↵", "\n"), ""))
    return rows


def is_said(expected: str, message: str) -> bool:
    """Whether the parts of what is expected are in a message, in their order."""
    begin = 0
    for part in expected.split("…"):
        begin = message.find(part, begin)
        if begin < 0:
            return False
        begin += len(part)
    return True
