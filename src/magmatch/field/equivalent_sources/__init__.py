# SPDX-License-Identifier: BSD-3-Clause
"""The field as that of charges and magnets outside of the region."""
