"""The page of a recommendation, made from the files in its folder."""

from pathlib import Path

from ... import io
from ...config import RECOMMENDED_FILE as RECOMMENDED
from ...settings.engines import ENGINES
from ..record._stored import REPORT
from ..record._sweeps import AdviseRecord

_FIGURE = "front"


def report_advice(folder: Path, record: AdviseRecord, form: str | None = None, dpi: int | None = None) -> Path:
    """Writes the page of the recommendation in `folder`, and its figure if a format `form` is given.

    **Returns** the page. **Raises** `FileError` if the recommendation is incomplete or damaged.
    """
    from .. import style
    from ..pages._next import after_advice
    from ..pages._page import lines_of, write_page
    from ._figure import draw_front
    from ._my_scene import scene_pictures

    advice = record.advice
    if advice is None or not (folder / RECOMMENDED).is_file():
        raise io.FileError(
            f"{folder} holds an incomplete recommendation; expected all techniques fitted: run advise again"
        )
    candidates = advice.candidates
    chosen = next(each for each in candidates if each.id == advice.recommended)
    if form is not None:
        style.save(draw_front(candidates, chosen), folder / f"{_FIGURE}.{form}", dpi or style.DPI)
    marks = {each.id: "front" for each in candidates if each.front} | {chosen.id: "recommended"}
    write_page(
        folder / REPORT,
        "advice.html.j2",
        name=record.name,
        over=advice.over,
        noise=advice.noise,
        candidates=candidates,
        marks=marks,
        validated=any(each.rmse != each.fit_rmse for each in candidates),
        verdict=advice.verdict,
        problems=advice.problems,
        figure=style.inline_svg(draw_front(candidates, chosen), _FIGURE),
        engine=None if advice.engine is None else ENGINES[advice.engine],
        scene=scene_pictures(folder) if advice.engine is not None else [],
        code={key: lines_of(text) for key, text in advice.code.items()},
        recommended=lines_of((folder / RECOMMENDED).read_text(encoding="utf-8", errors="backslashreplace")),
        file=RECOMMENDED,
        machine=record.versions.get("processor", "an unknown processor"),
        environment=[(name, value, "") for name, value in record.versions.items()],
        commands=after_advice(folder, advice.engine, record.command),
    )
    return folder / REPORT
