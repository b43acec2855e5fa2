"""Whether kernels are forked, and the settings they run under."""

from workbook.pinned import environment, pins, settings


def test_the_settings_of_another_processor_stand_in_for_the_pins(monkeypatch):
    monkeypatch.setenv(
        "STILLWORK_PROCESSOR", "OPENBLAS_CORETYPE=Zen NPY_DISABLE_CPU_FEATURES= NUMBA_CPU_NAME=generic"
    )
    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "AVX512_SPR")
    now = environment()
    assert now["OPENBLAS_CORETYPE"] == "Zen"
    assert now["NUMBA_CPU_NAME"] == "generic"
    assert "NPY_DISABLE_CPU_FEATURES" not in now
    assert now["OMP_NUM_THREADS"] == pins()["OMP_NUM_THREADS"] == "1"
    assert settings() != pins()
