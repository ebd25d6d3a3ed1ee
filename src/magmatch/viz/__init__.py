# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of the nouns: draws what others computed. Needs the extra 'viz'."""
