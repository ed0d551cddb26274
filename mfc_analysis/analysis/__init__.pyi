from . import frf as frf
from .comparison import Comparison as Comparison
from .disk import DiskMargin as DiskMargin
from .floquet import Floquet as Floquet, TransientGrowth as TransientGrowth
from .frf import FrequencyResponse as FrequencyResponse
from .margins import Margins as Margins, Worst as Worst
from .passivity import Passive as Passive, Passivity as Passivity
from .port import Port as Port
from .spectrum import Pole as Pole, PoleTable as PoleTable
from .stability import Stability as Stability
from .steps import Step as Step, Steps as Steps
