"""Training f_phi by Evidential Deep Learning (Sensoy et al. 2018): the only module that knows torch.

The network's outputs are evidence e = softplus(logits) >= 0 for each of N contexts, alpha = e + 1 the parameters of a
Dirichlet over the contexts' probabilities. With y the one-hot label, S = sum(alpha), psi the digamma function:

    L = sum_k y_k (psi(S) - psi(alpha_k))                 expected cross-entropy, eq. 4 there
      + lambda_t KL(Dir(y + (1 - y) alpha) || Dir(1))     misleading evidence, lambda_t annealed in
      + ood_weight KL(Dir(alpha~) || Dir(1))              alpha~ at unfamiliar scans; 0 = the paper's plain form

The last term is a remedy for plain EDL's confidence in places of no context; see `learning.unfamiliar`. Afterwards the
logits are scaled so that the given threshold lets the known places pass (`learning.calibration.evidence_factor`).
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from learning.augment import Augmentation, augmented, inputs_of
from learning.calibration import Round, TrainingReport, assess, evidence_factor, judge_all, sharpened
from learning.classifier import KERNEL, STRIDE, EvidentialClassifier, Floats, weight_shapes
from learning.labelled_scans import Integers, ScanDataset, balanced, split, time_blocks
from learning.policy import EPS_U
from learning.unfamiliar import NO_SCANS, Unfamiliar, unfamiliar_scans
from twin.records import Array

__all__ = ["Round", "ScanDataset", "Trained", "TrainingOptions", "TrainingReport", "time_blocks", "train"]

ROUND = 100  # steps between two looks at the validation loss
TENTH = 10  # a mean that moves by 10 / (9 + n) in step n has forgotten all but about the last tenth of the steps
OOD_HELD_OUT = 0.1  # share of the unfamiliar scans that only enter the validation loss


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How the classifier is trained."""

    loss: Literal["cross_entropy", "squared_error"] = "cross_entropy"  # eq. 4 or eq. 5 of Sensoy et al.
    hidden: int = 64  # units of the dense layer in between; 0 = the authors' network
    learning_rate: float = 1e-3  # Adam; the authors' 3e-4 needs three times the steps
    batch: int = 32  # labelled scans, and as many unfamiliar ones (authors)
    steps: int = 5000  # at most, whatever the number of scans (authors: 500 epochs)
    least_steps: int = 4000  # before that the evidence still grows, and a few held-out scans say little
    annealing_steps: int = 1000  # until the KL term has its full weight
    kl_weight: float = 0.1  # lambda after annealing; 1 holds back the evidence for the right context too
    ood_weight: float = 0.2  # of the uniform target at unfamiliar scans; 0 = the paper's plain EDL
    ood_scans: int = 3000  # made up once per training
    ood_made_up: float = 0.5  # share of made-up ones in the unfamiliar scans where there is a background
    validation_share: float = 0.2  # of each context's time blocks (authors: of the steps)
    averaged: bool = True  # take the mean of the weights over the last tenth of the steps; False = the last (authors)
    patience: int = 1000  # steps without a better validation loss after which training ends
    refit: bool = True  # then train anew on all blocks for as many steps as proved best (authors: full_train)
    threshold: float = EPS_U
    confident: float = 0.95  # of the held-out scans, by a factor on the logits afterwards; 0 = as trained (authors)
    augmentation: Augmentation = field(default_factory=Augmentation)
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.confident <= 1.0:
            raise ValueError(f"confident must be in [0, 1], not {self.confident}")
        if self.steps < 1:
            raise ValueError(f"steps must be at least 1, not {self.steps}")


# As published, as far as it is known.
PLAIN = TrainingOptions(
    hidden=0,
    learning_rate=3e-4,
    kl_weight=1.0,
    ood_weight=0.0,
    averaged=False,
    confident=0.0,
    augmentation=Augmentation(shift=math.radians(10.0), translation=0.10),
)


@dataclass(frozen=True, slots=True)
class Trained:
    """The outcome of a training."""

    classifier: EvidentialClassifier
    report: TrainingReport


# --- losses ----------------------------------------------------------------------------------------------------------


def uniform_kl(alpha: Tensor) -> Tensor:
    """(n, N) alpha to KL(Dir(alpha) || Dir(1)), (n,)."""
    total = alpha.sum(-1, keepdim=True)
    log_ratio = torch.lgamma(total.squeeze(-1)) - torch.lgamma(alpha).sum(-1) - math.lgamma(alpha.shape[-1])
    return log_ratio + ((alpha - 1.0) * (torch.digamma(alpha) - torch.digamma(total))).sum(-1)


def expected_cross_entropy(alpha: Tensor, y: Tensor) -> Tensor:
    """E over Dir(alpha) of -sum_k y_k log p_k, (n,)."""
    return (y * (torch.digamma(alpha.sum(-1, keepdim=True)) - torch.digamma(alpha))).sum(-1)


def expected_squared_error(alpha: Tensor, y: Tensor) -> Tensor:
    """E over Dir(alpha) of sum_k (y_k - p_k)^2, (n,)."""
    total = alpha.sum(-1, keepdim=True)
    p = alpha / total
    return ((y - p) ** 2 + p * (1.0 - p) / (total + 1.0)).sum(-1)


def evidential_loss(alpha: Tensor, y: Tensor, kl_weight: float, kind: str = "cross_entropy") -> Tensor:
    """The mean loss of labelled scans: alpha (n, N), one-hot y (n, N)."""
    data = expected_squared_error(alpha, y) if kind == "squared_error" else expected_cross_entropy(alpha, y)
    return (data + kl_weight * uniform_kl(y + (1.0 - y) * alpha)).mean()


# --- network ---------------------------------------------------------------------------------------------------------


class Network:
    """The same network as `EvidentialClassifier`, with gradients."""

    def __init__(self, contexts: int, hidden: int, rng: np.random.Generator) -> None:
        self.weights: dict[str, Tensor] = {}
        for name, shape in weight_shapes(contexts, hidden).items():
            if len(shape) == 1:
                value = np.zeros(shape)
            else:  # Glorot & Bengio 2010, what Keras layers begin with
                fans = shape[0] + (shape[1] * KERNEL if name == "kernel" else shape[1])
                value = rng.uniform(-1.0, 1.0, shape) * math.sqrt(6.0 / fans)
            self.weights[name] = torch.tensor(value, dtype=torch.float32, requires_grad=True)

    def alpha(self, inputs: Tensor) -> Tensor:
        """(n, 640) to (n, N)."""
        w = self.weights
        features = torch.relu(inputs.unfold(1, KERNEL, STRIDE) @ w["kernel"] + w["kernel_bias"]).flatten(1)
        if "hidden" in w:
            features = torch.relu(features @ w["hidden"] + w["hidden_bias"])
        return torch.nn.functional.softplus(features @ w["output"] + w["output_bias"]) + 1.0

    def approach(self, other: Network, share: float) -> None:
        """Move every weight by this share of the way to the other network's."""
        with torch.no_grad():
            for name, weight in self.weights.items():
                weight.lerp_(other.weights[name], share)

    def copy(self) -> dict[str, Floats]:
        """The weights as they are now."""
        return {name: tensor.detach().numpy().copy() for name, tensor in self.weights.items()}


@contextmanager
def _one_thread() -> Iterator[None]:
    """Sums in one order whatever the machine has: the same seed gives the same weights."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


# --- training --------------------------------------------------------------------------------------------------------


def train(
    dataset: ScanDataset,
    options: TrainingOptions = TrainingOptions(),
    *,
    background: Array | None = None,
    outside: Array | None = None,
    progress: Callable[[Round], None] | None = None,
) -> Trained:
    """Train a classifier on labelled scans; equal inputs give equal weights.

    background: (m, 720) scans of places where nobody intervened, used like the made-up unfamiliar scans (needs
        ood_weight > 0). outside: (m, 720) scans of no context, only reported on. Raises ValueError for data from
        which nothing can be learnt.
    """
    began = time.perf_counter()
    dataset = dataset.usable()
    contexts = dataset.contexts
    if len(contexts) < 2:
        raise ValueError(f"a context classifier needs scans of two contexts or more, not of {list(contexts)}")
    if background is not None and len(background) and options.ood_weight <= 0.0:
        raise ValueError("background scans need ood_weight > 0")
    rng = np.random.default_rng(options.seed)
    taught, held = split(dataset, options.validation_share, rng)
    ood_scans = options.ood_scans if options.ood_weight > 0.0 else 0
    share, how = options.ood_made_up, options.augmentation
    aside, strange = unfamiliar_scans(taught, ood_scans, background, share, how, rng).split(OOD_HELD_OUT, rng)
    with _one_thread():
        descent = _Descent(taught, held, strange, aside, contexts, options, rng)
        rounds = tuple(descent.run(options.steps, progress))
        examined = deployed = EvidentialClassifier.from_weights(contexts, descent.best)
        best_step = descent.best_step
        if options.refit:
            everywhere = unfamiliar_scans(dataset, ood_scans, background, share, how, rng)
            descent = _Descent(dataset, None, everywhere, None, contexts, options, rng)
            rounds += tuple(descent.run(best_step, progress))
            deployed = EvidentialClassifier.from_weights(contexts, descent.best)
    factor = evidence_factor(examined, held.scans, options.confident, options.threshold)
    examined, deployed = sharpened(examined, factor), sharpened(deployed, factor)
    beyond = judge_all(deployed, NO_SCANS if outside is None else outside)
    report = TrainingReport(
        contexts=contexts,
        training_scans=len(taught.labels),
        held_out=assess(examined, held.scans, held.labels, options.threshold),
        unfamiliar_share=judge_all(deployed, aside.made_up).confident_share(options.threshold),
        outside_share=beyond.confident_share(options.threshold),
        outside_confidence=beyond.mean_confidence,
        evidence_factor=factor,
        best_step=best_step,
        rounds=rounds,
        seconds=time.perf_counter() - began,
    )
    return Trained(deployed, report)


class _Descent:
    """Adam with early stopping; `best` holds the mean weights with the lowest validation loss so far.

    Averaged, because the confidence that the last weights give depends on which few scans came last (polynomial-decay
    averaging, Shamir & Zhang 2013). Without held-out scans there is no early stopping, and `best` holds the last mean.
    """

    def __init__(
        self,
        taught: ScanDataset,
        held: ScanDataset | None,
        strange: Unfamiliar,
        strange_held: Unfamiliar | None,
        contexts: tuple[str, ...],
        options: TrainingOptions,
        rng: np.random.Generator,
    ) -> None:
        self._options, self._rng = options, rng
        self._scans, self._truth = taught.scans, taught.indices(contexts)
        self._one_hot = torch.eye(len(contexts))
        self._strange = strange
        self._held: tuple[Tensor, Integers, Tensor] | None = None
        if held is not None and strange_held is not None:
            # Every context counts the same in the validation loss too.
            order = balanced(held.indices(contexts), len(held.labels), rng)
            known, truth = inputs_of(held.scans[order]), held.indices(contexts)[order]
            unknown = inputs_of(np.concatenate([strange_held.made_up, strange_held.background]))
            self._held = torch.from_numpy(known), truth, torch.from_numpy(unknown)
        self._network = Network(len(contexts), options.hidden, rng)
        self._mean = copy.deepcopy(self._network)
        self._adam = torch.optim.Adam(list(self._network.weights.values()), lr=options.learning_rate, fused=True)
        self.best: dict[str, Floats] = self._mean.copy()
        self.best_step = 0

    def run(self, steps: int, progress: Callable[[Round], None] | None) -> Iterator[Round]:
        """Train for `steps` steps at most; one Round per 100 of them."""
        lowest = math.inf
        for start in range(0, steps, ROUND):
            count = min(ROUND, steps - start)
            training, validation = self._steps(start, count), self._validation()
            result = Round(start + count, training, validation)
            if progress is not None:
                progress(result)
            yield result
            if self._held is None or validation < lowest or result.steps <= min(steps, self._options.least_steps):
                lowest, self.best_step, self.best = validation, result.steps, self._mean.copy()
            elif result.steps - self.best_step >= self._options.patience:
                return

    def _steps(self, start: int, count: int) -> float:
        """Train for `count` steps; their mean loss."""
        options, total = self._options, 0.0
        order = balanced(self._truth, count * options.batch, self._rng)
        inputs = torch.from_numpy(augmented(self._scans, order, self._rng, options.augmentation))
        strange = torch.from_numpy(self._strange.draw(count * options.batch, options.augmentation, self._rng))
        for step in range(count):
            here = slice(step * options.batch, (step + 1) * options.batch)
            kl_weight = options.kl_weight * min(1.0, (start + step) / max(1, options.annealing_steps))
            loss = self._loss(self._network, inputs[here], self._truth[order[here]], strange[here], kl_weight)
            self._adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self._adam.step()
            self._mean.approach(self._network, TENTH / (start + step + TENTH) if options.averaged else 1.0)
            total += loss.item()
        return total / count

    def _validation(self) -> float:
        if self._held is None:
            return math.nan
        with torch.no_grad():
            return self._loss(self._mean, *self._held, self._options.kl_weight).item()

    def _loss(self, network: Network, inputs: Tensor, truth: Integers, strange: Tensor, kl_weight: float) -> Tensor:
        alpha = network.alpha(torch.cat([inputs, strange]))
        known, unknown = alpha[: len(inputs)], alpha[len(inputs) :]
        loss = evidential_loss(known, self._one_hot[torch.from_numpy(truth)], kl_weight, self._options.loss)
        return loss + self._options.ood_weight * uniform_kl(unknown).mean() if len(unknown) else loss
