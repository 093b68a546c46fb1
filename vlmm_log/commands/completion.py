"""``vlmm-log completion``."""

from __future__ import annotations

import click

from vlmm_log.commands.examples import examples

ASKED_BY = "_VLMM_LOG_COMPLETE"  # the variable by which click's scripts ask what a word may become


@click.command(
    epilog=examples(
        "vlmm-log completion bash >> ~/.bashrc",
        "vlmm-log completion zsh >> ~/.zshrc",
        "vlmm-log completion fish > ~/.config/fish/completions/vlmm-log.fish",
    )
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the script that lets a SHELL complete commands, options and files. It asks vlmm-log itself at each Tab."""
    from click.shell_completion import get_completion_class

    of_shell = get_completion_class(shell)
    assert of_shell is not None, shell
    root = click.get_current_context().find_root()
    click.echo(of_shell(root.command, {}, "vlmm-log", ASKED_BY).source())
