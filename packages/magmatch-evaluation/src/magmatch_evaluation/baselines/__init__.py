# SPDX-License-Identifier: BSD-3-Clause
"""Other methods, same input and same result type: what this package's registration is measured against."""
