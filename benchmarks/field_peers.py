# SPDX-License-Identifier: BSD-3-Clause
"""What one would use instead of a field map: interpolators and Gaussian processes, each choosing its own numbers.

Every peer is a function ``(points, field, queries) -> field``. Those of GPyTorch are there where it is installed.
"""

from importlib.util import find_spec

import numpy as np

from magmatch_evaluation.baselines.interpolation import N_LIKELIHOOD, inverse_distance, local_gp, nearest_neighbour

HAS_GPYTORCH = find_spec("gpytorch") is not None
N_EXACT = 3000
N_INDUCING = 400
BATCH = 500


def thinned(points, n):
    """Rows of at most n samples, evenly along the recording."""
    return np.arange(0, len(points), -(-len(points) // n))


def svgp(points, field, queries):
    """GPyTorch's stochastic variational GP: components independent, inducing points from the samples, Adam."""
    import gpytorch
    import torch

    torch.manual_seed(0)
    rows = thinned(points, N_INDUCING)
    centre, scale = field.mean(axis=0), field.std()
    x, y = torch.from_numpy(points).float(), torch.from_numpy((field - centre) / scale).float()

    class Model(gpytorch.models.ApproximateGP):
        def __init__(self, inducing):
            variational = gpytorch.variational
            distribution = variational.CholeskyVariationalDistribution(len(inducing), batch_shape=torch.Size([3]))
            strategy = variational.VariationalStrategy(self, inducing.repeat(3, 1, 1), distribution)
            super().__init__(variational.IndependentMultitaskVariationalStrategy(strategy, num_tasks=3))
            self.mean_module = gpytorch.means.ConstantMean(batch_shape=torch.Size([3]))
            kernel = gpytorch.kernels.RBFKernel(batch_shape=torch.Size([3]))
            self.covar_module = gpytorch.kernels.ScaleKernel(kernel, batch_shape=torch.Size([3]))

        def forward(self, x):
            return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    model = Model(x[rows].clone())
    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(num_tasks=3, rank=0)
    likelihood.noise = 0.05
    optimiser = torch.optim.Adam([*model.parameters(), *likelihood.parameters()], lr=0.03)
    bound = gpytorch.mlls.VariationalELBO(likelihood, model, num_data=len(x))
    for _ in range(200):
        batch = torch.randint(len(x), (256,))
        optimiser.zero_grad()
        (-bound(model(x[batch]), y[batch])).backward()
        optimiser.step()
    model.eval()
    with torch.no_grad():
        chunks = torch.from_numpy(queries).float().split(2000)
        mean = torch.cat([model(chunk).mean for chunk in chunks]).numpy()
    return mean.astype(np.float64) * scale + centre


def gpytorch_exact(points, field, queries):
    """GPyTorch's exact GP on an even subset: one squared-exponential kernel, numbers by Adam on fewer samples."""
    import gpytorch
    import torch

    centre, scale = field.mean(axis=0), field.std()
    size = torch.Size([3])

    class Model(gpytorch.models.ExactGP):
        def __init__(self, x, y, likelihood):
            super().__init__(x, y, likelihood)
            self.mean_module = gpytorch.means.ConstantMean(batch_shape=size)
            self.covar_module = gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernel())

        def forward(self, x):
            mean = self.mean_module(x)
            kernel = self.covar_module(x)
            return gpytorch.distributions.MultivariateNormal(mean, kernel.expand(*size, *kernel.shape[-2:]))

    def data(n):
        rows = thinned(points, n)
        return torch.from_numpy(points[rows]), torch.from_numpy(((field[rows] - centre) / scale).T.copy())

    likelihood = gpytorch.likelihoods.GaussianLikelihood()
    x, y = data(N_LIKELIHOOD)
    model = Model(x, y, likelihood).double()
    optimiser = torch.optim.Adam(model.parameters(), lr=0.1)
    evidence = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, model)
    with gpytorch.settings.max_cholesky_size(10_000):
        for _ in range(60):
            optimiser.zero_grad()
            (-evidence(model(x), y).sum()).backward()
            optimiser.step()
        model.set_train_data(*data(N_EXACT), strict=False)
        model.eval()
        with torch.no_grad(), gpytorch.settings.skip_posterior_variances(True):
            chunks = torch.from_numpy(queries).split(2000)
            mean = torch.cat([model(chunk).mean for chunk in chunks], dim=-1).numpy()
    return mean.T * scale + centre


PEERS = {
    "nearest neighbour": nearest_neighbour,
    "IDW, k = 8": inverse_distance,
    "local GP": local_gp,
} | ({"GPyTorch SVGP": svgp, "GPyTorch exact, subset": gpytorch_exact} if HAS_GPYTORCH else {})


def exact_divergence_free(points, field, queries, lengthscale, signal_sd, noise_sd):
    """GPyTorch's exact GP with the published kernel and given numbers: fit and mean by Cholesky."""
    import gpytorch
    import torch

    class DivergenceFree(gpytorch.kernels.Kernel):
        has_lengthscale = False

        def num_outputs_per_input(self, x1, x2):  # noqa: ARG002
            return 3

        def forward(self, x1, x2, diag=False, **_):
            if diag:
                return torch.full((3 * len(x1),), signal_sd**2, dtype=x1.dtype)
            d = (x1[:, None] - x2[None]) / lengthscale
            square = (d * d).sum(-1)
            blocks = d[..., :, None] * d[..., None, :] + (2 - square)[..., None, None] * torch.eye(3, dtype=d.dtype)
            blocks *= (0.5 * signal_sd**2 * torch.exp(-0.5 * square))[..., None, None]
            return blocks.permute(0, 2, 1, 3).reshape(3 * len(x1), 3 * len(x2))

    class Model(gpytorch.models.ExactGP):
        def __init__(self, x, y, likelihood):
            super().__init__(x, y, likelihood)
            self.mean_module = gpytorch.means.MultitaskMean(gpytorch.means.ZeroMean(), num_tasks=3)
            self.covar_module = DivergenceFree()

        def forward(self, x):
            return gpytorch.distributions.MultitaskMultivariateNormal(self.mean_module(x), self.covar_module(x))

    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(
        3, has_task_noise=False, noise_constraint=gpytorch.constraints.GreaterThan(1e-8)
    ).double()
    likelihood.noise = noise_sd**2
    model = Model(torch.from_numpy(points), torch.from_numpy(field), likelihood).double().eval()
    exactly = gpytorch.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False)
    with torch.no_grad(), exactly, gpytorch.settings.skip_posterior_variances(True):
        return torch.cat([model(chunk).mean for chunk in torch.from_numpy(queries).split(BATCH)]).numpy()
