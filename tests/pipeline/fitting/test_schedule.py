from pipeline.fitting.schedule import warm_up_cosine


def test_the_rate_rises_then_falls_to_zero() -> None:
    rates = [warm_up_cosine(step / 100, 0.15) for step in range(101)]
    top = rates.index(max(rates))
    assert top == 15
    assert rates[top] == 1.0
    assert rates[:16] == sorted(rates[:16])
    assert rates[15:] == sorted(rates[15:], reverse=True)
    assert 0 < rates[0] < 0.1
    assert rates[-1] < 1e-9
