"""Training f_phi by Evidential Deep Learning (Sensoy et al. 2018): the only module that knows torch.

The network's outputs are evidence e = softplus(logits) >= 0 for each of N contexts, alpha = e + 1 the parameters of a
Dirichlet over the contexts' probabilities. With y the one-hot label, S = sum(alpha), psi the digamma function:

    L = sum_k y_k (psi(S) - psi(alpha_k))                                expected cross-entropy, eq. 4 there
      + lambda_t KL(Dir(y + (1 - y) alpha) || Dir(1))                    misleading evidence, lambda_t annealed in
      + ood_weight KL(Dir(alpha~) || Dir(1))                             alpha~ at unfamiliar scans; 0 = the paper's form

The last term is a remedy for plain EDL's confidence in places of no context; see `learning.unfamiliar`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.augment import Augmentation, augmented
from learning.calibration import (
    Judgements,
    Reliability,
    accuracy,
    confident_share,
    judge_all,
    mean_confidence,
    reliability,
)
from learning.classifier import BEAMS, CROP, KERNEL, STRIDE, EvidentialClassifier, preprocess, weight_shapes
from learning.unfamiliar import made_up_scans
from twin.records import Array

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ScanDataset:
    """Labelled scans. Raises ValueError when the arrays do not fit together."""

    scans: Array  # (n, 720) [m], right to left; no return = inf
    labels: tuple[str, ...]  # (n,) context of each scan
    blocks: Integers  # (n,) id of a stretch of time in one intervention; a block is never split

    def __post_init__(self) -> None:
        n = len(self.labels)
        if self.scans.ndim != 2 or self.scans.shape[1] != BEAMS:
            raise ValueError(f"scans must have the shape (n, {BEAMS}), not {self.scans.shape}")
        if len(self.scans) != n or self.blocks.shape != (n,):
            raise ValueError(f"{len(self.scans)} scans, {n} labels and {len(self.blocks)} block ids do not match")

    @property
    def contexts(self) -> tuple[str, ...]:
        """The contexts, in alphabetical order: the order of the classifier's outputs."""
        return tuple(sorted(set(self.labels)))

    def indices(self, contexts: tuple[str, ...]) -> Integers:
        """(n,) position of each scan's label in `contexts`."""
        return np.array([contexts.index(label) for label in self.labels], dtype=np.int64)


def time_blocks(times: Array, sources: Integers, seconds: float = 1.0) -> Integers:
    """Block ids (n,) for steps at `times` [s] of interventions `sources`: stretches of about `seconds` each."""
    pairs = np.column_stack([sources, np.floor(times / seconds).astype(np.int64)])
    return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How the classifier is trained. Defaults are the authors' where they have one, or say why."""

    loss: Literal["cross_entropy", "squared_error"] = "cross_entropy"  # eq. 4 or eq. 5 of Sensoy et al.
    learning_rate: float = 3e-4  # Adam (authors)
    batch: int = 32  # (authors)
    epochs: int = 500  # at most (authors)
    annealing_epochs: int = 10  # until the KL term has its full weight (Sensoy et al.)
    kl_weight: float = 1.0  # lambda at the end of annealing
    ood_weight: float = 1.0  # of the uniform target at unfamiliar scans; 0 = the paper's plain EDL
    ood_scans: int = 3000  # made up once per training
    validation_share: float = 0.2  # of each context's time blocks (authors: of the steps)
    patience: int = 60  # epochs without a better validation loss before training ends
    threshold: float = 0.8  # eps_u at which the report counts confident scans
    augmentation: Augmentation = field(default_factory=Augmentation)
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Epoch:
    """One epoch's losses."""

    index: int
    training: float
    validation: float


@dataclass(frozen=True, slots=True)
class TrainingReport:
    """What training measured on the time blocks it held out, and outside all contexts."""

    contexts: tuple[str, ...]
    training_scans: int
    held_out_scans: int
    accuracy: float  # held-out
    confidence: float  # held-out mean u
    confident_share: float  # held-out, u >= threshold
    accuracy_by_context: dict[str, float]
    confidence_by_context: dict[str, float]
    by_confidence: Reliability  # u against accuracy
    by_probability: Reliability  # alpha_max / sum(alpha) against accuracy
    unfamiliar_share: float  # made-up scans with u >= threshold; NaN with ood_weight = 0
    outside_share: float  # given scans of no context with u >= threshold; NaN without any
    outside_confidence: float  # their mean u; NaN without any
    best_epoch: int
    epochs: tuple[Epoch, ...]
    seconds: float


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


def evidential_loss(alpha: Tensor, y: Tensor, kl_weight: float, kind: str) -> Tensor:
    """The mean loss of labelled scans: alpha (n, N), one-hot y (n, N)."""
    data = expected_squared_error(alpha, y) if kind == "squared_error" else expected_cross_entropy(alpha, y)
    return (data + kl_weight * uniform_kl(y + (1.0 - y) * alpha)).mean()


# --- network ---------------------------------------------------------------------------------------------------------


class Network:
    """The same network as `EvidentialClassifier`, with gradients."""

    def __init__(self, contexts: int, rng: np.random.Generator) -> None:
        self.weights: dict[str, Tensor] = {}
        for name, shape in weight_shapes(contexts).items():
            if len(shape) == 1:
                value = np.zeros(shape)
            else:  # Glorot & Bengio 2010, what Keras layers begin with
                fans = shape[0] + (shape[1] * KERNEL if name == "kernel" else shape[1])
                value = rng.uniform(-1.0, 1.0, shape) * math.sqrt(6.0 / fans)
            self.weights[name] = torch.tensor(value, dtype=torch.float32, requires_grad=True)

    def alpha(self, inputs: Tensor) -> Tensor:
        """(n, 640) to (n, N)."""
        w = self.weights
        hidden = torch.relu(inputs.unfold(1, KERNEL, STRIDE) @ w["kernel"] + w["kernel_bias"])
        return torch.nn.functional.softplus(hidden.flatten(1) @ w["dense"] + w["dense_bias"]) + 1.0

    def copy(self) -> dict[str, NDArray[np.float32]]:
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


def split(truth: Integers, blocks: Integers, share: float, rng: np.random.Generator) -> tuple[Integers, Integers]:
    """Training and validation positions: `share` of each context's time blocks is held out, whole, at least one."""
    held = np.zeros(len(truth), dtype=bool)
    for k in np.unique(truth):
        own = np.unique(blocks[truth == k])
        count = min(max(1, round(share * len(own))), len(own) - 1)
        held |= (truth == k) & np.isin(blocks, rng.permutation(own)[:count])
    return np.flatnonzero(~held), np.flatnonzero(held)


def balanced(truth: Integers, rng: np.random.Generator) -> Integers:
    """One epoch's order: as many positions as there are scans, every context equally often."""
    present = np.unique(truth)
    each = math.ceil(len(truth) / len(present))
    drawn = []
    for k in present:
        own = np.flatnonzero(truth == k)
        rounds = [rng.permutation(own) for _ in range(math.ceil(each / len(own)))]
        drawn.append(np.concatenate(rounds)[:each])
    return rng.permutation(np.concatenate(drawn))


def train(
    dataset: ScanDataset,
    options: TrainingOptions = TrainingOptions(),
    *,
    background: Array | None = None,
    outside: Array | None = None,
    progress: Callable[[Epoch], None] | None = None,
) -> Trained:
    """Train a classifier on labelled scans; equal inputs give equal weights.

    background: (m, 720) scans of places where nobody intervened, used like the made-up unfamiliar scans (needs
        ood_weight > 0). outside: (m, 720) scans of no context, only reported on. Raises ValueError for data from
        which nothing can be learnt.
    """
    began = time.perf_counter()
    usable = np.isfinite(dataset.scans).any(axis=1)  # scans that cannot be judged cannot teach either
    contexts = dataset.contexts
    truth, scans, blocks = dataset.indices(contexts)[usable], dataset.scans[usable], dataset.blocks[usable]
    _refuse(contexts, truth, blocks, options, background)
    rng = np.random.default_rng(options.seed)
    training, held = split(truth, blocks, options.validation_share, rng)
    unfamiliar = np.empty((0, BEAMS))
    if options.ood_weight > 0.0:
        unfamiliar = made_up_scans(scans[training], truth[training], blocks[training], options.ood_scans, rng)
        if background is not None:
            # As often as the made-up ones: real places count as much as all invented ones together.
            real = background[np.isfinite(background).any(axis=1)]
            if len(real):
                unfamiliar = np.concatenate([unfamiliar, real[rng.integers(0, len(real), len(unfamiliar))]])
    with _one_thread():
        weights, epochs = _descend(scans, truth, training, held, unfamiliar, len(contexts), options, rng, progress)
    classifier = EvidentialClassifier(contexts, **weights)
    best = min(epochs, key=lambda epoch: epoch.validation).index
    return Trained(
        classifier,
        _report(classifier, scans, truth, training, held, unfamiliar, outside, options, best, epochs, began),
    )


def _refuse(
    contexts: tuple[str, ...], truth: Integers, blocks: Integers, options: TrainingOptions, background: Array | None
) -> None:
    if len(contexts) < 2:
        raise ValueError(f"a context classifier needs interventions of two contexts or more, not of {list(contexts)}")
    for k, label in enumerate(contexts):
        if (count := len(np.unique(blocks[truth == k]))) < 2:
            raise ValueError(f"context {label!r} has {count} time blocks with usable scans; two or more are needed")
    if background is not None and options.ood_weight <= 0.0:
        raise ValueError("background scans need ood_weight > 0")


def _descend(
    scans: Array,
    truth: Integers,
    training: Integers,
    held: Integers,
    unfamiliar: Array,
    contexts: int,
    options: TrainingOptions,
    rng: np.random.Generator,
    progress: Callable[[Epoch], None] | None,
) -> tuple[dict[str, NDArray[np.float32]], tuple[Epoch, ...]]:
    """Adam with early stopping: the weights of the epoch with the lowest validation loss, and all epochs."""
    network = Network(contexts, rng)
    optimiser = torch.optim.Adam(network.weights.values(), lr=options.learning_rate)
    one_hot = torch.eye(contexts)
    strange = np.array([preprocess(scan) for scan in unfamiliar]).reshape(-1, CROP)
    strange_held, strange = strange[: len(strange) // 10], strange[len(strange) // 10 :]
    held_inputs = torch.from_numpy(np.array([preprocess(scan) for scan in scans[held]]))
    # Every context counts the same in the validation loss too.
    held_order = balanced(truth[held], np.random.default_rng(options.seed))
    best, best_loss, epochs = network.copy(), math.inf, list[Epoch]()
    for index in range(options.epochs):
        kl_weight = options.kl_weight * min(1.0, index / max(1, options.annealing_epochs))
        order, total = training[balanced(truth[training], rng)], 0.0
        inputs = torch.from_numpy(augmented(scans[order], rng, options.augmentation))
        batches = range(0, len(order), options.batch)
        for start in batches:
            here = slice(start, start + options.batch)
            alpha = network.alpha(inputs[here])
            loss = evidential_loss(alpha, one_hot[truth[order[here]]], kl_weight, options.loss)
            if len(strange):
                picked = torch.from_numpy(strange[rng.integers(0, len(strange), options.batch)])
                loss = loss + options.ood_weight * uniform_kl(network.alpha(picked)).mean()
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            total += loss.item()
        with torch.no_grad():
            alpha = network.alpha(held_inputs)[held_order]
            validation = evidential_loss(alpha, one_hot[truth[held[held_order]]], options.kl_weight, options.loss)
            if len(strange_held):
                validation += options.ood_weight * uniform_kl(network.alpha(torch.from_numpy(strange_held))).mean()
        epochs.append(Epoch(index, total / len(batches), validation.item()))
        if progress is not None:
            progress(epochs[-1])
        if epochs[-1].validation < best_loss:
            best, best_loss = network.copy(), epochs[-1].validation
        elif index - min(epochs, key=lambda epoch: epoch.validation).index >= options.patience:
            break
    return best, tuple(epochs)


def _report(
    classifier: EvidentialClassifier,
    scans: Array,
    truth: Integers,
    training: Integers,
    held: Integers,
    unfamiliar: Array,
    outside: Array | None,
    options: TrainingOptions,
    best: int,
    epochs: tuple[Epoch, ...],
    began: float,
) -> TrainingReport:
    answers = judge_all(classifier, scans[held])
    correct = answers.index == truth[held]
    of = [np.flatnonzero(truth[held] == k) for k in range(len(classifier.labels))]
    beyond: Judgements = judge_all(classifier, np.empty((0, BEAMS)) if outside is None else outside)
    return TrainingReport(
        contexts=classifier.labels,
        training_scans=len(training),
        held_out_scans=len(held),
        accuracy=accuracy(answers, truth[held]),
        confidence=mean_confidence(answers),
        confident_share=confident_share(answers, options.threshold),
        accuracy_by_context={k: float(correct[i].mean()) for k, i in zip(classifier.labels, of, strict=True)},
        confidence_by_context={
            k: float(answers.confidence[i].mean()) for k, i in zip(classifier.labels, of, strict=True)
        },
        by_confidence=reliability(answers.confidence, correct),
        by_probability=reliability(answers.probability, correct),
        unfamiliar_share=confident_share(judge_all(classifier, unfamiliar), options.threshold),
        outside_share=confident_share(beyond, options.threshold),
        outside_confidence=mean_confidence(beyond),
        best_epoch=best,
        epochs=epochs,
        seconds=time.perf_counter() - began,
    )
