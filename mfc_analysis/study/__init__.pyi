from .errors import StudyError as StudyError
from .read import Case as Case, Study as Study, StudyLoop as StudyLoop, keys as keys, read as read
