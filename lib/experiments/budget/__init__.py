"""The machine of four papers: the FeRLS isolator under the thesis's stage, its floors, and the waterfall of methods."""
