"""Who may do what: keys, roles, leases, rates, and the audit."""
