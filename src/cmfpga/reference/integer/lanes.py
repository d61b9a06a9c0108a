"""Model of :mod:`cmfpga.rtl.image.lanes`: how long votes wait for each other. Sums do not depend on it."""

DEPTH = 16  # of a queue, its head among them


def waits(config, votes):
    """Clock cycles that an iteration takes more than if no vote had to wait.

    Parameters
    ----------
    config : Config
    votes : Votes
        Of the iteration's events, in their order.
    """
    lanes = config.lanes
    classes = (2 * (votes.row & 1) + (votes.column & 1)).tolist()
    banks = ((votes.row // 2 + votes.column // 2) % lanes).tolist()
    inside = votes.inside.tolist()
    count = len(inside)
    groups = -(-count // lanes)
    # A queue of each class, lane and half of the banks, the head first; what is wanted, or None for no head.
    names = [(number, lane, half) for number in range(4) for lane in range(lanes) for half in range(2)]
    queues, heads = {name: [] for name in names}, dict.fromkeys(names)
    sent, last, room, soon, cycle = 0, None, True, True, 0  # room now, and in the next cycle
    while last is None or cycle < last + 3 or any(queues.values()) or any(head is not None for head in heads.values()):
        full = any(len(queue) >= DEPTH - 3 for queue in queues.values())
        # Every bank takes the head of the lane whose turn it is, or of the next that wants it.
        taken = set()
        for number in range(4):
            for bank in range(lanes):
                for k in range(lanes):
                    name = number, (cycle - 1 + number + k) % lanes, bank & 1
                    if heads[name] == bank:
                        taken.add(name)
                        break
        for name, queue in queues.items():
            if queue and (name in taken or heads[name] is None):
                heads[name] = queue.pop(0)
            elif name in taken:
                heads[name] = None
        if room and sent < groups:
            for lane, k in enumerate(range(sent * lanes, min(count, (sent + 1) * lanes))):
                for there, number, bank in zip(inside[k], classes[k], banks[k], strict=True):
                    if there:
                        queues[number, lane, bank & 1].append(bank)
            sent += 1
            last = cycle if sent == groups else None
        room, soon, cycle = soon, not full, cycle + 1
    return cycle - (groups + 2)
