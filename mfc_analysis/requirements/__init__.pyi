from .requirements import Line as Line, Requirements as Requirements, Status as Status, Verdict as Verdict
