"""The subcommands of `caterpillar`: one module each, arguments and output alone."""
