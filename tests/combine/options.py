"""The options of a program, from its own table, and random values for them."""

import subprocess


class Option:
    def __init__(self, line):
        columns = line.rstrip("\n").split("\t")
        self.name, self.key, self.kind = columns[:3]
        self.least, self.most = float(columns[3]), float(columns[4])
        self.words = columns[5].replace("/", " ").split()
        self.argument = columns[6]

    @property
    def id(self):
        return self.name + (" " + self.key if self.key else "")


def read(program):
    """Returns the options that `program --list-options` names."""
    text = subprocess.run([program, "--list-options"], capture_output=True, text=True, check=True).stdout
    return [Option(line) for line in text.splitlines()]


def value_of(option, random):
    """Returns a random value of an option whose kind says what it takes; "" for one without."""
    if option.kind == "choice" or option.kind == "flag":
        return random.choice(option.words) if option.words else ""
    if option.words and random.random() < 0.2:
        return random.choice(option.words)
    if option.kind == "count":
        most = min(option.most, max(option.least, random.choice([4, 12, 12, 40])))
        return str(random.randint(int(option.least), int(most)))
    if option.kind == "number":
        return "%.6g" % min(option.most, max(option.least, 10 ** random.uniform(-3, 2)))
    if option.kind == "bytes":
        return "%dK" % 2 ** random.uniform(9, 21)
    if option.kind == "output":  # names of outputs of a bake begin with m_
        return "m_" + option.name + (option.argument[4:] if option.argument.startswith("FILE.") else "")
    raise ValueError("--%s: no random value for the kind %s" % (option.id, option.kind))
