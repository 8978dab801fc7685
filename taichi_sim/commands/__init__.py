"""The command `taichi-sim`, and those of its subcommands that need no learning."""
