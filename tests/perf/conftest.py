"""Speed is measured without the shape checks that other tests run with."""

import jaxtyping

jaxtyping.config.update("jaxtyping_disable", True)
