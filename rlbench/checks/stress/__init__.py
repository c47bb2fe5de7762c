"""Stress tests: how a method behaves when its input is wrong, extreme or very long.

`rlbench check` asks whether a method keeps the contract; a stress test asks what happens beyond it.
Each module holds one section. A section is a list of tests, and each test gives one `CheckResult`
per method: a figure, its thresholds, and a verdict.
"""
