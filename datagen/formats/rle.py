"""Run-length encoding of masks as in COCO: lengths of runs of 0 and 1 in turn, down the columns, beginning with 0."""

from typing import Any

import numpy as np
from jaxtyping import Bool


def encode_rle(mask: Bool[np.ndarray, "height width"]) -> dict[str, Any]:
    """Encode a mask; the counts stay a list, which all readers of COCO accept.

    >>> import numpy as np
    >>> encode_rle(np.array([[False, True], [True, True]]))
    {'size': [2, 2], 'counts': [1, 3]}
    """
    column_by_column = mask.T.ravel()
    starts = np.flatnonzero(np.diff(column_by_column)) + 1
    bounds = [0, *starts.tolist(), column_by_column.size]
    counts = np.diff(bounds).tolist()
    return {"size": list(mask.shape), "counts": [0, *counts] if column_by_column[0] else counts}
