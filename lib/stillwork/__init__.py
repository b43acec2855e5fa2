"""A reproducible research workbook on machines that must hold still.

Four rooms, one published work each: `stillwork.isolation`, `stillwork.motion`, `stillwork.worstcase`
and `stillwork.fixedpoint`. Import the room you need; this package alone imports nothing heavy.
"""

__version__ = "0.1.0"
