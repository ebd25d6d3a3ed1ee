# SPDX-License-Identifier: BSD-3-Clause
"""What registration, slam and localisation weigh and decide by: priors, null models, noise, and the posterior."""
