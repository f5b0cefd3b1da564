"""Section ``train``: fitting a model."""

from pydantic import Field, field_validator

from pipeline.base.params import Count, Positive, Section, Seed


class Train(Section):
    epochs: Count = Field(description="largest number of epochs")
    patience: Count = Field(
        description="epochs without a lower validation error, averaged over three epochs, after "
        "which training stops. It has no effect from `epochs` on, or without validation drives. "
        "Below half of `epochs` it may stop while the learning rate is still high"
    )
    seeds: list[Seed] = Field(
        min_length=1, description="one network of each model is trained per seed"
    )
    learning_rate: Positive = Field(
        description="largest learning rate. It rises at first, then falls"
    )
    weight_decay: float = Field(
        ge=0, le=100, description="weight decay of AdamW, for matrices only"
    )
    clip_norm: Positive = Field(
        description="largest norm of the gradient. A larger gradient is scaled to it"
    )
    span_windows: Count = Field(
        description="consecutive windows in a span, which share the embeddings of their frames"
    )
    batch_spans: Count = Field(description="spans in an optimiser step, of about as many drives")
    rescale: float = Field(
        ge=1,
        le=2,
        description="largest random factor by which the scene of a span, and its bends, are "
        "scaled. 1 is no scaling",
    )
    average: float = Field(
        ge=0,
        lt=1,
        description="decay per step of the exponential moving average of the weights, which are "
        "validated and saved. The epoch with the lowest error, averaged over three epochs, is "
        "saved. 0 is no average of the weights",
    )

    @field_validator("seeds")
    @classmethod
    def _check_different(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("expected each seed once")
        return seeds
