from .arm import arm as arm
from .batch import drawn as drawn
from .block import block as block
from .costs import costs as costs
from .disk import disk as disk, multipliers as multipliers
from .figure import axes_for as axes_for, panels_for as panels_for, shown as shown, svg as svg
from .frequency import bode as bode, frequencies_of as frequencies_of, nyquist as nyquist, of_channel as of_channel, two_axes as two_axes
from .maps import log_axes as log_axes, stability_map as stability_map
from .margins import margin_history as margin_history, margins as margins, metric_values as metric_values
from .measured import comparison as comparison, response as response
from .overview import overview as overview
from .poles import poles as poles
from .port import admittance as admittance, passivity as passivity
from .runs import Panel as Panel, curves as curves, traces as traces
from .steps import responses as responses, step as step
