"""Sky-Watcher motor controllers (EQMod, EQDIR, Wi-Fi): they know counts; the sky is computed here."""
