"""The page "What the paper must have used": the windows of its continuous choices."""

from collections import defaultdict

from workbook.choices.axes import Multiverse
from workbook.choices.kept import Joint
from workbook.choices.settings import Meeting, meetings


def by_axis(joint: Joint) -> dict[str, list[Meeting]]:
    """Windows of each choice, together for every setting of the others; those under which they meet come first."""
    found = defaultdict(list)
    for met in sorted(meetings(joint.windows), key=lambda met: not met.pieces):
        found[met.axis].append(met)
    return {axis: found[axis] for axis in dict.fromkeys(each.axis for each in joint.windows)}


def unsearched(multiverses: list[Multiverse]) -> list[str]:
    """Choices of numbers between which others could stand and of which no study searches a range."""
    searched = {axis for each in multiverses for axis in each.windows}
    numeric = {
        axis.name: None
        for each in multiverses
        for axis in each.axes
        if all(isinstance(option, float) for option in axis.options)
    }
    return [axis for axis in numeric if axis not in searched]
