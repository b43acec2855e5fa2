"""The part of an installed checkout that a wheel lacks: the workbook's extension of the Jupyter server."""

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CheckoutHook(BuildHookInterface):
    """Every Jupyter server of an environment with the checkout saves its notebooks in their committed form."""

    def initialize(self, version, build_data):
        if version == "editable":
            build_data["shared_data"]["lib/workbook/lab.json"] = (
                "etc/jupyter/jupyter_server_config.d/stillwork.json"
            )
