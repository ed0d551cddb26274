from .loops.report import write as write
from .render.write import render as render, rendered as rendered
