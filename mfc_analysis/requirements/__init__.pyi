from .line import Line as Line, Status as Status
from .requirements import Requirements as Requirements, Verdict as Verdict
