"""A reproducible research workbook on machines that must hold still.

The toolbox: `stillwork.signals`, `stillwork.lti`, `stillwork.identification`, `stillwork.estimation` and
`stillwork.control`, on `stillwork.base`; a folder imports only those named before it. The package `workbook` beside it
makes notebooks and pages. Import the folder you need; this package alone imports nothing heavy.
"""

__version__ = "0.1.0"
