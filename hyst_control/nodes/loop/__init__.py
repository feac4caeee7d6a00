# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of the nodes of the loop: actuator, takeover, watch over rivals, learning, recorded topics."""
