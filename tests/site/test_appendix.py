"""An appendix on the page of its notebook: text, numbers and pictures in their order, apart from the answer."""

import io

from PIL import Image

from workbook.appendix import KIND
from workbook.conclusions import Sentence
from workbook.site.pages import _cells

TEXT = "## More\n\nWhy $x^2$.\n\n```\ngain 2\n```\n\n![fig-2](fig-2.png)\n\nAfter it.\n"


def test_it_stands_behind_its_cell_with_the_pictures_where_they_were_saved(tmp_path):
    picture = io.BytesIO()
    Image.new("RGB", (4, 3)).save(picture, "PNG")
    (tmp_path / "fig-2.png").write_bytes(picture.getvalue())
    outputs = [
        {"output_type": "display_data", "data": {"text/plain": "one *x*", "text/markdown": "one *x*"}},
        {"output_type": "display_data", "data": {"text/plain": "Appendix: 1 picture.", KIND: TEXT}},
    ]
    raw = [{"cell_type": "code", "id": "last", "source": "page.appendix()", "outputs": outputs}]
    cell, first, second = _cells("topic/01-x", raw, tmp_path, [], b"")
    assert cell.outputs == (Sentence("one *x*"),) and not cell.apart
    assert "<em>x</em>" in cell.shown[0]
    assert (first.apart, second.apart) == (True, True)
    assert [figure.name for figure in first.figures] == ["fig-2"] and second.figures == ()
    assert "gain 2" in first.html and "fig-2.png" not in first.html and "More" in first.html
    assert "After it." in second.html
