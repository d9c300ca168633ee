"""The examples in docs/rayiou.md, run one after the other."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "rayiou.md"


def test_examples_on_the_page():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 4
    exec(compile("\n".join(blocks), str(PAGE), "exec"), {})
