// Has StellarSolver, Ekos' library, solve an image at a server of the nova API, and prints what it understood.
//
// Arguments: FITS-FILE RAW-FILE WIDTH HEIGHT URL KEY image|stars
// RAW-FILE: 16-bit pixels of this machine's byte order, the first row first. "image" uploads FITS-FILE, "stars" a
// table of stars that StellarSolver extracts itself.

#include <cstdio>

#include <QCoreApplication>
#include <QObject>
#include <QTimer>

#include <stellarsolver.h>

#include "../stellarsolver_frame.h"

int main(int count, char **given)
{
    QCoreApplication app(count, given);
    if (count != 8)
        return 2;
    RawFrame frame;
    if (!frame.read(given[2], given[3], given[4]))
        return 2;

    StellarSolver solver(frame.image, frame.data());
    bool stars = QString(given[7]) == "stars";
    solver.setProperty("ProcessType", SOLVE);
    solver.setProperty("ExtractorType", stars ? EXTRACTOR_INTERNAL : EXTRACTOR_BUILTIN);
    solver.setProperty("SolverType", SOLVER_ONLINEASTROMETRY);
    solver.setProperty("FileToProcess", QString(given[1]));
    solver.setProperty("AstrometryAPIURL", QString(given[5]));
    solver.setProperty("AstrometryAPIKey", QString(given[6]));
    solver.setSearchScale(3.8, 4.2, ARCSEC_PER_PIX);
    solver.setSearchPositionInDegrees(85.1, 29.95);
    solver.setProperty("UseScale", true);
    solver.setProperty("UsePosition", true);
    solver.setLogLevel(LOG_ALL);
    solver.setSSLogLevel(LOG_NORMAL);
    // Its thread that waits stops listening when it happens to look between its question for the calibration and
    // the answer: it then waits for ever. What it says last tells: code 4
    bool requesting = false;
    QObject::connect(&solver, &StellarSolver::logOutput, &app, [&](const QString &words) {
        std::fprintf(stderr, "%s\n", words.toUtf8().constData());
        if (words.startsWith("Requesting the results"))
            requesting = true;
        else if (words.startsWith("Downloading"))
            requesting = false;
        else if (words.startsWith("Waiting for Stars and WCS") && requesting)
            QTimer::singleShot(5000, &app, [&]() {
                if (requesting)
                    app.exit(4);
            });
    });
    QObject::connect(&solver, &StellarSolver::finished, &app, [&]() {
        if (solver.solvingDone() && !solver.failed())
        {
            FITSImage::Solution found = solver.getSolution();
            std::printf("%.6f %.6f %.6f %.6f %.6f %.6f %d\n", found.ra, found.dec, found.pixscale, found.orientation,
                        found.fieldWidth, found.fieldHeight, int(solver.hasWCSData()));
        }
        app.exit(solver.failed() ? 1 : 0);
    });
    QTimer::singleShot(60000, &app, [&]() { app.exit(3); });
    QTimer::singleShot(0, &app, [&]() { solver.start(); });
    return app.exec();
}
